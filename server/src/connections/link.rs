//! What is known of one connection while it is open: every call on it finds this among its extensions.

use std::{
    net::SocketAddr,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering::Relaxed},
    },
};

/// One connection; clones are the same one.
#[derive(Debug, Clone)]
pub(crate) struct Link(Arc<State>);

#[derive(Debug)]
struct State {
    peer: SocketAddr,
    /// A call has come.
    called: AtomicBool,
    /// Bytes that have come.
    received: AtomicU64,
}

impl Link {
    pub(super) fn new(peer: SocketAddr) -> Self {
        Self(Arc::new(State { peer, called: AtomicBool::new(false), received: AtomicU64::new(0) }))
    }

    /// Who is at the other end.
    pub(crate) fn peer(&self) -> SocketAddr {
        self.0.peer
    }

    /// A call has come on it.
    pub(super) fn call(&self) {
        self.0.called.store(true, Relaxed);
    }

    pub(super) fn called(&self) -> bool {
        self.0.called.load(Relaxed)
    }

    pub(super) fn receive(&self, bytes: usize) {
        self.0.received.fetch_add(bytes as u64, Relaxed);
    }

    pub(super) fn received(&self) -> u64 {
        self.0.received.load(Relaxed)
    }
}
