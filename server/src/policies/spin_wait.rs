//! Spinning for the next request instead of sleeping.
//!
//! A sleeping thread wakes late; on virtual processors the processor itself may have to wake first, with cold caches.
//! When the last request arrived within the limit, as in a closed-loop simulator, the next one probably will too, and
//! spinning is cheaper than sleeping. At a robot's control rate the thread always sleeps.

use std::{
    num::NonZero,
    sync::{
        LazyLock,
        atomic::{AtomicUsize, Ordering::Relaxed},
    },
    time::{Duration, Instant},
};

/// Limits how many threads of this process spin at once: half of the processors; the others carry messages.
static PERMITS: LazyLock<SpinPermits> =
    LazyLock::new(|| SpinPermits::new(std::thread::available_parallelism().map_or(1, NonZero::get) / 2));

/// The spin state of one thread.
pub(super) struct SpinWait {
    /// The longest spin; zero disables spinning.
    max_spin: Duration,
    /// Whether the last wait was shorter than `max_spin`.
    last_was_short: bool,
}

impl SpinWait {
    pub(super) fn new(max_spin: Duration) -> Self {
        Self { max_spin, last_was_short: false }
    }

    /// Waits for the next item; `None` when every sender is dropped.
    pub(super) fn next<T>(&mut self, waiting: &flume::Receiver<T>) -> Option<T> {
        let begun = Instant::now();
        let permit = self.last_was_short.then(|| PERMITS.take()).flatten();
        let next = permit.and_then(|_permit| spin_until(waiting, begun + self.max_spin));
        let next = next.unwrap_or_else(|| waiting.recv().ok());
        self.last_was_short = begun.elapsed() < self.max_spin;
        next
    }
}

/// Polls until an item arrives or every sender is dropped; `None` when the time is over.
fn spin_until<T>(waiting: &flume::Receiver<T>, until: Instant) -> Option<Option<T>> {
    loop {
        match waiting.try_recv() {
            Ok(next) => return Some(Some(next)),
            Err(flume::TryRecvError::Disconnected) => return Some(None),
            Err(flume::TryRecvError::Empty) if Instant::now() >= until => return None,
            Err(flume::TryRecvError::Empty) => std::hint::spin_loop(),
        }
    }
}

/// Permits to spin.
struct SpinPermits {
    free: AtomicUsize,
}

/// Returned on drop.
struct SpinPermit<'a>(&'a SpinPermits);

impl SpinPermits {
    fn new(count: usize) -> Self {
        Self { free: AtomicUsize::new(count) }
    }

    fn take(&self) -> Option<SpinPermit<'_>> {
        self.free.fetch_update(Relaxed, Relaxed, |free| free.checked_sub(1)).ok().map(|_| SpinPermit(self))
    }
}

impl Drop for SpinPermit<'_> {
    fn drop(&mut self) {
        self.0.free.fetch_add(1, Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HOUR: Duration = Duration::from_secs(3600);

    #[test]
    fn a_thread_spins_only_after_a_short_wait() {
        let (send, waiting) = flume::unbounded();
        let mut spin_wait = SpinWait::new(HOUR);
        assert!(!spin_wait.last_was_short, "no request yet");
        send.send(1).unwrap();
        assert_eq!((spin_wait.next(&waiting), spin_wait.last_was_short), (Some(1), true));
        let mut sleeper = SpinWait::new(Duration::ZERO);
        send.send(2).unwrap();
        assert_eq!((sleeper.next(&waiting), sleeper.last_was_short), (Some(2), false), "a limit of zero never spins");
    }

    #[test]
    fn spinning_receives_items_and_sees_the_end() {
        let (send, waiting) = flume::unbounded();
        let later = std::thread::spawn(move || send.send(3).unwrap());
        assert_eq!(spin_until(&waiting, Instant::now() + HOUR), Some(Some(3)));
        later.join().unwrap();
        assert_eq!(spin_until(&waiting, Instant::now() + HOUR), Some(None));
        let (_send, waiting) = flume::unbounded::<u8>();
        assert_eq!(spin_until(&waiting, Instant::now()), None, "the time is over");
        for last_was_short in [true, false] {
            let (send, waiting) = flume::unbounded::<u8>();
            drop(send);
            assert_eq!(SpinWait { max_spin: HOUR, last_was_short }.next(&waiting), None);
        }
    }

    #[test]
    fn permits_limit_the_spinning_threads() {
        let permits = SpinPermits::new(1);
        let permit = permits.take().unwrap();
        assert!(permits.take().is_none());
        drop(permit);
        assert!(permits.take().is_some());
        assert!(SpinPermits::new(0).take().is_none(), "a single processor never spins");
    }
}
