//! Unread pieces of responses: those handed to the transport after which the peer has requested no more. A peer that
//! reads its socket but opens no flow-control window is detected in no other way. Must not depend on connections.

use std::{
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicU64, Ordering::Relaxed},
    },
    time::Duration,
};

use tokio::time::Instant;

/// A response without an unread piece.
const NOTHING: u64 = 0;

/// The running responses of one connection; clones share them.
#[derive(Debug, Clone)]
pub(crate) struct PendingResponses(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    begun: Instant,
    /// For each response, the time since which a piece of it waits: milliseconds since the start, plus one.
    open: Mutex<Vec<Arc<AtomicU64>>>,
}

impl PendingResponses {
    pub(crate) fn new() -> Self {
        Self(Arc::new(Inner { begun: Instant::now(), open: Mutex::default() }))
    }

    /// Adds a response; it counts until it is dropped.
    pub(crate) fn begin(&self) -> PendingResponse {
        let since = Arc::new(AtomicU64::new(NOTHING));
        self.0.open().push(Arc::clone(&since));
        PendingResponse { all: self.clone(), since }
    }

    /// The time since which the oldest unread piece of any response waits.
    pub(crate) fn oldest(&self) -> Option<Instant> {
        let open = self.0.open();
        let waiting = open.iter().map(|since| since.load(Relaxed)).filter(|&since| since != NOTHING);
        waiting.min().map(|since| self.0.begun + Duration::from_millis(since - 1))
    }
}

impl Inner {
    fn open(&self) -> MutexGuard<'_, Vec<Arc<AtomicU64>>> {
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// One response, until it is dropped.
#[derive(Debug)]
pub(crate) struct PendingResponse {
    all: PendingResponses,
    since: Arc<AtomicU64>,
}

impl PendingResponse {
    /// Records that a piece was handed to the transport.
    pub(crate) fn piece_sent(&self) {
        let since = self.all.0.begun.elapsed().as_millis();
        self.since.store(u64::try_from(since).unwrap_or(u64::MAX - 1) + 1, Relaxed);
    }

    /// Records that the peer requested more, so the last piece is on its way.
    pub(crate) fn piece_read(&self) {
        self.since.store(NOTHING, Relaxed);
    }
}

impl Drop for PendingResponse {
    fn drop(&mut self) {
        self.all.0.open().retain(|since| !Arc::ptr_eq(since, &self.since));
    }
}
