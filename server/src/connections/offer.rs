//! What answers have handed out and their peers have not taken: a peer that reads its socket but asks for no more of an
//! answer shows nowhere else. A connection looks here for the oldest.

use std::{
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicU64, Ordering::Relaxed},
    },
    time::Duration,
};

use tokio::time::Instant;

use super::link::Link;

/// An answer of which nothing waits to be taken.
const NOTHING: u64 = 0;

/// The answers of one connection that are under way.
#[derive(Debug)]
pub(super) struct Offers {
    begun: Instant,
    /// For each, since when a piece of it waits: milliseconds from the beginning, and one more.
    open: Mutex<Vec<Arc<AtomicU64>>>,
}

impl Offers {
    pub(super) fn new() -> Self {
        Self { begun: Instant::now(), open: Mutex::default() }
    }

    /// Since when a piece of some answer has not been taken.
    pub(super) fn oldest(&self) -> Option<Instant> {
        let open = self.open();
        let waiting = open.iter().map(|since| since.load(Relaxed)).filter(|&since| since != NOTHING);
        waiting.min().map(|since| self.begun + Duration::from_millis(since - 1))
    }

    fn open(&self) -> MutexGuard<'_, Vec<Arc<AtomicU64>>> {
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// One answer, until it is dropped.
pub(super) struct Offer {
    link: Link,
    since: Arc<AtomicU64>,
}

impl Offer {
    pub(super) fn new(link: Link) -> Self {
        let since = Arc::new(AtomicU64::new(NOTHING));
        link.offers().open().push(Arc::clone(&since));
        Self { link, since }
    }

    /// A piece was handed out.
    pub(super) fn made(&self) {
        let since = self.link.offers().begun.elapsed().as_millis();
        self.since.store(u64::try_from(since).unwrap_or(u64::MAX - 1) + 1, Relaxed);
    }

    /// More is asked for: what was handed out is on its way.
    pub(super) fn taken(&self) {
        self.since.store(NOTHING, Relaxed);
    }
}

impl Drop for Offer {
    fn drop(&mut self) {
        self.link.offers().open().retain(|since| !Arc::ptr_eq(since, &self.since));
    }
}
