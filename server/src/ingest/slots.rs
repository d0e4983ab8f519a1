//! Slots for inspections, shared fairly between clients. A waiter that is dropped leaves the queue.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::oneshot;

use super::fair_queue::{FairQueue, Ticket};
use crate::{
    domain::client::Client,
    error::{Error, Result},
};

/// The slots of one server; clones share them.
#[derive(Debug, Clone)]
pub(super) struct Slots(Arc<Mutex<FairQueue<Client, oneshot::Sender<Slot>>>>);

/// A slot, released on drop.
#[derive(Debug)]
pub(super) struct Slot {
    slots: Slots,
    client: Client,
}

/// A place in the queue, released on drop.
struct Waiting<'a> {
    slots: &'a Slots,
    client: &'a Client,
    ticket: Ticket,
}

impl Slots {
    pub(super) fn new(slots: usize) -> Self {
        Self(Arc::new(Mutex::new(FairQueue::new(slots))))
    }

    /// Waits for a slot.
    ///
    /// # Errors
    /// Internal; a defect, because every waiter is served or leaves.
    pub(super) async fn take(&self, client: &Client) -> Result<Slot> {
        let (give, given) = oneshot::channel();
        let ticket = self.queue().join(client, give);
        let _waiting = Waiting { slots: self, client, ticket };
        self.admit();
        given.await.map_err(|error| Error::internal("waiting for an inspection", error))
    }

    /// Hands free slots to waiters.
    fn admit(&self) {
        loop {
            // The lock is released before a slot is handed over: the slot of a waiter that has just left is dropped
            // here.
            let Some((client, waiter)) = self.queue().admit() else { return };
            let _ = waiter.send(Slot { slots: self.clone(), client });
        }
    }

    /// The slots that a client holds, and its waiters.
    #[cfg(test)]
    pub(super) fn count(&self, client: &Client) -> (usize, usize) {
        self.queue().count(client)
    }

    fn queue(&self) -> MutexGuard<'_, FairQueue<Client, oneshot::Sender<Slot>>> {
        // The queue is whole after every call, so a panic elsewhere does not spoil it.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Slot {
    fn drop(&mut self) {
        self.slots.queue().release(&self.client);
        self.slots.admit();
    }
}

impl Drop for Waiting<'_> {
    fn drop(&mut self) {
        self.slots.queue().leave(self.client, self.ticket);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn token(name: &str) -> Client {
        Client::Token(name.into())
    }

    #[tokio::test]
    async fn a_dropped_slot_goes_to_the_next_waiter() {
        let (slots, a, b) = (Slots::new(1), token("a"), token("b"));
        let held = slots.take(&a).await.unwrap();
        let mut waiting = Box::pin(slots.take(&b));
        assert!(futures::poll!(&mut waiting).is_pending());
        assert_eq!((slots.count(&a), slots.count(&b)), ((1, 0), (0, 1)));
        drop(held);
        let held = waiting.await.unwrap();
        assert_eq!((slots.count(&a), slots.count(&b)), ((0, 0), (1, 0)));
        drop(held);
        assert_eq!(slots.count(&b), (0, 0));
    }

    #[tokio::test]
    async fn a_dropped_waiter_leaves_the_queue() {
        let (slots, a) = (Slots::new(1), token("a"));
        let held = slots.take(&a).await.unwrap();
        let mut gone = Box::pin(slots.take(&a));
        let mut next = Box::pin(slots.take(&a));
        assert!(futures::poll!(&mut gone).is_pending() && futures::poll!(&mut next).is_pending());
        drop(gone);
        assert_eq!(slots.count(&a), (1, 1));
        drop(held);
        drop(next.await.unwrap());

        // A waiter that was given a slot and dropped before reading it gives the slot back, too.
        let held = slots.take(&a).await.unwrap();
        let mut unread = Box::pin(slots.take(&a));
        assert!(futures::poll!(&mut unread).is_pending());
        drop(held);
        assert_eq!(slots.count(&a), (1, 0));
        drop(unread);
        assert_eq!(slots.count(&a), (0, 0));
    }
}
