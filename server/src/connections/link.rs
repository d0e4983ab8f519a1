//! What is known of one connection while it is open: every call on it finds this among its extensions.

use std::{
    net::SocketAddr,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering::Relaxed},
    },
};

use super::{offer::Offers, places::household};
use crate::domain::client::Client;

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
    offers: Offers,
}

impl Link {
    pub(crate) fn new(peer: SocketAddr) -> Self {
        let (called, received) = (AtomicBool::new(false), AtomicU64::new(0));
        Self(Arc::new(State { peer, called, received, offers: Offers::new() }))
    }

    /// Who is at the other end.
    pub(crate) fn peer(&self) -> SocketAddr {
        self.0.peer
    }

    /// The client at the other end, as far as its address tells.
    pub(crate) fn client(&self) -> Client {
        Client::Address(household(self.peer().ip()))
    }

    /// A call has come on it.
    pub(crate) fn call(&self) {
        self.0.called.store(true, Relaxed);
    }

    pub(super) fn called(&self) -> bool {
        self.0.called.load(Relaxed)
    }

    pub(super) fn receive(&self, bytes: usize) {
        self.0.received.fetch_add(bytes as u64, Relaxed);
    }

    /// What its answers have handed out.
    pub(super) fn offers(&self) -> &Offers {
        &self.0.offers
    }

    pub(super) fn received(&self) -> u64 {
        self.0.received.load(Relaxed)
    }
}
