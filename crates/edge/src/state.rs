//! The state of one open connection; every call on it finds this among its extensions.

use std::{
    net::{IpAddr, SocketAddr},
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering::Relaxed},
    },
};

use crate::{pending::PendingResponses, permits::peer_key};

/// One connection; clones share its state.
#[derive(Debug, Clone)]
pub struct ConnectionState(Arc<State>);

#[derive(Debug)]
struct State {
    peer: SocketAddr,
    /// Whether a call has arrived.
    called: AtomicBool,
    /// Bytes received.
    received: AtomicU64,
    pending: PendingResponses,
}

impl ConnectionState {
    /// A connection with this peer, without a call yet.
    pub fn new(peer: SocketAddr) -> Self {
        let (called, received) = (AtomicBool::new(false), AtomicU64::new(0));
        Self(Arc::new(State { peer, called, received, pending: PendingResponses::new() }))
    }

    /// The address of the peer.
    pub fn peer(&self) -> SocketAddr {
        self.0.peer
    }

    /// The key for counting the peer: its IPv4 address, or the /64 of its IPv6 address.
    pub fn peer_key(&self) -> IpAddr {
        peer_key(self.peer().ip())
    }

    /// Records a call, which meets the deadline of the first call.
    pub fn note_call(&self) {
        self.0.called.store(true, Relaxed);
    }

    pub(crate) fn called(&self) -> bool {
        self.0.called.load(Relaxed)
    }

    pub(crate) fn receive(&self, bytes: usize) {
        self.0.received.fetch_add(bytes as u64, Relaxed);
    }

    pub(crate) fn received(&self) -> u64 {
        self.0.received.load(Relaxed)
    }

    /// The responses of its calls.
    pub(crate) fn pending(&self) -> &PendingResponses {
        &self.0.pending
    }
}
