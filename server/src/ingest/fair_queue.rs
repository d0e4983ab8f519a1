//! The order in which waiting clients get free slots: round robin between clients, first in first out within one.
//!
//! With more than one slot, no client holds all of them, so a client without a slot finds one unless other clients took
//! it. Pure data: `slots` does the waiting.

use std::collections::VecDeque;

/// Clients of type `K` that hold slots or wait for one with a `W` each.
#[derive(Debug)]
pub(super) struct FairQueue<K, W> {
    slots: usize,
    /// Each client with a slot or a waiter. One goes to the end when it gives a slot back.
    clients: Vec<Waiters<K, W>>,
    next_ticket: Ticket,
}

/// Identifies one waiter.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Ticket(u64);

#[derive(Debug)]
struct Waiters<K, W> {
    client: K,
    running: usize,
    waiting: VecDeque<(Ticket, W)>,
}

impl<K: Clone + Eq, W> FairQueue<K, W> {
    /// A queue for this many slots; zero counts as one.
    pub(super) fn new(slots: usize) -> Self {
        Self { slots: slots.max(1), clients: Vec::new(), next_ticket: Ticket(0) }
    }

    /// Adds a waiter behind the client's others. [`FairQueue::admit`] may have a slot for it at once.
    pub(super) fn join(&mut self, client: &K, waiter: W) -> Ticket {
        let ticket = self.next_ticket;
        self.next_ticket = Ticket(ticket.0.wrapping_add(1));
        if !self.clients.iter().any(|entry| entry.client == *client) {
            self.clients.push(Waiters { client: client.clone(), running: 0, waiting: VecDeque::new() });
        }
        if let Some(entry) = self.find(client) {
            entry.waiting.push_back((ticket, waiter));
        }
        ticket
    }

    /// Removes a waiter that stopped waiting; one that was admitted already is left alone.
    pub(super) fn leave(&mut self, client: &K, ticket: Ticket) {
        if let Some(entry) = self.find(client) {
            entry.waiting.retain(|(other, _)| *other != ticket);
        }
        self.forget_idle();
    }

    /// Gives a free slot to a waiter, if there are both: of the clients with the fewest slots, the one that is first in
    /// turn.
    pub(super) fn admit(&mut self) -> Option<(K, W)> {
        let running: usize = self.clients.iter().map(|entry| entry.running).sum();
        if running >= self.slots {
            return None;
        }
        // With a single slot there is none to keep for others.
        let most = self.slots.saturating_sub(1).max(1);
        let may_run = |entry: &Waiters<K, W>| !entry.waiting.is_empty() && entry.running < most;
        let eligible = self.clients.iter().enumerate().filter(|(_, entry)| may_run(entry));
        // The first of equals.
        let (index, _) = eligible.min_by_key(|(_, entry)| entry.running)?;
        let entry = self.clients.get_mut(index)?;
        let (_, waiter) = entry.waiting.pop_front()?;
        entry.running += 1;
        Some((entry.client.clone(), waiter))
    }

    /// Releases a slot of the client, which is the last in turn from then on: a client that joined meanwhile goes
    /// before its next waiter.
    pub(super) fn release(&mut self, client: &K) {
        if let Some(index) = self.clients.iter().position(|entry| entry.client == *client) {
            let mut entry = self.clients.remove(index);
            entry.running = entry.running.saturating_sub(1);
            self.clients.push(entry);
        }
        self.forget_idle();
    }

    /// The slots that a client holds, and its waiters.
    #[cfg(test)]
    pub(super) fn count(&self, client: &K) -> (usize, usize) {
        let entry = self.clients.iter().find(|entry| entry.client == *client);
        entry.map_or((0, 0), |entry| (entry.running, entry.waiting.len()))
    }

    fn find(&mut self, client: &K) -> Option<&mut Waiters<K, W>> {
        self.clients.iter_mut().find(|entry| entry.client == *client)
    }

    fn forget_idle(&mut self) {
        self.clients.retain(|entry| entry.running > 0 || !entry.waiting.is_empty());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    type Queue = FairQueue<&'static str, u32>;

    /// A queue where each client has waiters numbered from 1.
    fn queue(slots: usize, waiting: &[(&'static str, u32)]) -> Queue {
        let mut queue = Queue::new(slots);
        for (client, count) in waiting {
            for number in 1..=*count {
                queue.join(client, number);
            }
        }
        queue
    }

    fn admitted(queue: &mut Queue) -> Vec<(&'static str, u32)> {
        std::iter::from_fn(|| queue.admit()).collect()
    }

    #[test]
    fn one_slot_goes_to_clients_in_turn() {
        let mut queue = queue(1, &[("a", 3), ("b", 2), ("c", 1)]);
        let mut order = Vec::new();
        while let Some((client, number)) = queue.admit() {
            assert_eq!(queue.admit(), None, "there is one slot");
            order.push((client, number));
            queue.release(&client);
        }
        assert_eq!(order, [("a", 1), ("b", 1), ("c", 1), ("a", 2), ("b", 2), ("a", 3)]);
        assert!(queue.clients.is_empty(), "idle clients are forgotten");
    }

    #[test]
    fn no_client_holds_every_slot() {
        let mut queue = queue(3, &[("a", 6)]);
        assert_eq!(admitted(&mut queue), [("a", 1), ("a", 2)]);
        queue.join(&"b", 1);
        assert_eq!(admitted(&mut queue), [("b", 1)]);
        queue.release(&"a");
        queue.join(&"b", 2);
        queue.join(&"c", 1);
        assert_eq!(admitted(&mut queue), [("c", 1)], "of a, b and c, only c has no slot");
    }

    #[test]
    fn among_equals_the_client_that_returned_a_slot_first_is_next() {
        let mut queue = queue(2, &[("a", 3), ("b", 3)]);
        assert_eq!(admitted(&mut queue), [("a", 1), ("b", 1)]);
        queue.release(&"b");
        assert_eq!(admitted(&mut queue), [("b", 2)], "a holds as many slots as one client may");
        queue.release(&"b");
        queue.release(&"a");
        assert_eq!(admitted(&mut queue), [("b", 3), ("a", 2)]);
    }

    #[test]
    fn a_client_that_joins_waits_for_one_slot_of_another() {
        let mut queue = queue(1, &[("a", 3)]);
        assert_eq!(admitted(&mut queue), [("a", 1)]);
        queue.join(&"b", 1);
        queue.release(&"a");
        assert_eq!(admitted(&mut queue), [("b", 1)]);
    }

    /// Two clients that come back as soon as they were served cannot keep a third waiting.
    #[test]
    fn clients_that_return_go_behind_those_that_wait() {
        let mut queue = queue(1, &[("a", 2), ("b", 1), ("c", 1)]);
        let mut order = Vec::new();
        for _ in 0..6 {
            let Some((client, _)) = queue.admit() else { break };
            order.push(client);
            queue.release(&client);
            if client != "a" {
                queue.join(&client, 1);
            }
        }
        assert_eq!(order, ["a", "b", "c", "a", "b", "c"]);
    }

    #[test]
    fn a_waiter_that_leaves_is_skipped() {
        let mut queue = Queue::new(1);
        let first = queue.join(&"a", 1);
        queue.join(&"a", 2);
        queue.leave(&"a", first);
        assert_eq!(admitted(&mut queue), [("a", 2)]);
        queue.leave(&"a", first);
        assert_eq!(queue.count(&"a"), (1, 0), "an admitted waiter is not undone");
    }
}
