//! Whether a model's thread waits awake for what comes next.
//!
//! A thread that sleeps wakes late, and where processors are virtual on one that has to be woken first and has forgotten
//! the model's weights. Whoever asked again at once last time, as a simulator does, probably will: then it is cheaper to
//! look than to sleep. A robot at its control rate never keeps anybody awake.

use std::{
    num::NonZero,
    sync::{
        LazyLock,
        atomic::{AtomicUsize, Ordering::Relaxed},
    },
    time::{Duration, Instant},
};

/// So many of this process's threads may be awake for nothing at once: half of the processors, the others carry messages.
static PLACES: LazyLock<Places> =
    LazyLock::new(|| Places::new(std::thread::available_parallelism().map_or(1, NonZero::get) / 2));

/// One thread's.
pub(super) struct Vigil {
    /// A wait shorter than this is worth staying awake for; zero: none is.
    longest: Duration,
    /// The last one was.
    brisk: bool,
}

impl Vigil {
    pub(super) fn new(longest: Duration) -> Self {
        Self { longest, brisk: false }
    }

    /// What comes next; `None` when nobody can send any more.
    pub(super) fn next<T>(&mut self, waiting: &flume::Receiver<T>) -> Option<T> {
        let begun = Instant::now();
        let place = self.brisk.then(|| PLACES.take()).flatten();
        let next = place.and_then(|_place| watch(waiting, begun + self.longest));
        let next = next.unwrap_or_else(|| waiting.recv().ok());
        self.brisk = begun.elapsed() < self.longest;
        next
    }
}

/// Looks until something comes, or nobody is there to send it; `None` at the end of the time.
fn watch<T>(waiting: &flume::Receiver<T>, until: Instant) -> Option<Option<T>> {
    loop {
        match waiting.try_recv() {
            Ok(next) => return Some(Some(next)),
            Err(flume::TryRecvError::Disconnected) => return Some(None),
            Err(flume::TryRecvError::Empty) if Instant::now() >= until => return None,
            Err(flume::TryRecvError::Empty) => std::hint::spin_loop(),
        }
    }
}

/// Places to be awake.
struct Places {
    free: AtomicUsize,
}

/// Given back when dropped.
struct Place<'a>(&'a Places);

impl Places {
    fn new(many: usize) -> Self {
        Self { free: AtomicUsize::new(many) }
    }

    fn take(&self) -> Option<Place<'_>> {
        self.free.fetch_update(Relaxed, Relaxed, |free| free.checked_sub(1)).ok().map(|_| Place(self))
    }
}

impl Drop for Place<'_> {
    fn drop(&mut self) {
        self.0.free.fetch_add(1, Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HOUR: Duration = Duration::from_secs(3600);

    #[test]
    fn only_who_was_asked_again_at_once_stays_awake() {
        let (send, waiting) = flume::unbounded();
        let mut vigil = Vigil::new(HOUR);
        assert!(!vigil.brisk, "nothing was asked yet");
        send.send(1).unwrap();
        assert_eq!((vigil.next(&waiting), vigil.brisk), (Some(1), true));
        let mut sleeper = Vigil::new(Duration::ZERO);
        send.send(2).unwrap();
        assert_eq!((sleeper.next(&waiting), sleeper.brisk), (Some(2), false), "no wait is that short");
    }

    #[test]
    fn what_comes_while_it_is_awake_is_taken_and_the_end_is_seen() {
        let (send, waiting) = flume::unbounded();
        let later = std::thread::spawn(move || send.send(3).unwrap());
        assert_eq!(watch(&waiting, Instant::now() + HOUR), Some(Some(3)));
        later.join().unwrap();
        assert_eq!(watch(&waiting, Instant::now() + HOUR), Some(None));
        let (_send, waiting) = flume::unbounded::<u8>();
        assert_eq!(watch(&waiting, Instant::now()), None, "then it sleeps");
        for brisk in [true, false] {
            let (send, waiting) = flume::unbounded::<u8>();
            drop(send);
            assert_eq!(Vigil { longest: HOUR, brisk }.next(&waiting), None);
        }
    }

    #[test]
    fn no_more_are_awake_than_there_are_places() {
        let places = Places::new(1);
        let place = places.take().unwrap();
        assert!(places.take().is_none());
        drop(place);
        assert!(places.take().is_some());
        assert!(Places::new(0).take().is_none(), "one processor has none to spare");
    }
}
