//! The connections of the server: who may open one, how long it may be silent or slow, and what its calls may ask for.
//! The transport leaves all of this open.
//!
//! Knows bytes, addresses and the paths of calls. Must not know what any call means.

mod accept;
mod body;
mod calls;
mod guarded;
mod layer;
mod link;
mod places;
mod rate;
#[cfg(test)]
mod tests;

use std::sync::Arc;

use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;

pub(crate) use self::{
    accept::{Incoming, incoming},
    calls::Client,
    guarded::Guarded,
    layer::CallsLayer,
    link::Link,
};
use self::{calls::Calls, places::Places};
use crate::config::ConnectionsConfig;

/// Takes as many file descriptors as the system lets this process have: each connection needs one, and the usual first
/// limit is a thousand.
pub(crate) fn claim_descriptors() {
    let limits = getrlimit(Resource::Nofile);
    if limits.current < limits.maximum || limits.maximum.is_none() {
        let raised = Rlimit { current: limits.maximum, maximum: limits.maximum };
        if let Err(error) = setrlimit(Resource::Nofile, raised) {
            tracing::warn!(%error, "the limit on open files stays as it was");
        }
    }
}

/// What holds for every connection; clones share it.
#[derive(Clone)]
pub(crate) struct Connections(Arc<Rules>);

struct Rules {
    config: ConnectionsConfig,
    places: Places,
    calls: Calls,
    /// Cancelled when every connection is to end now.
    cut: CancellationToken,
}

impl Connections {
    pub(crate) fn new(config: ConnectionsConfig) -> Self {
        let places = Places::new(config.max_connections, config.max_connections_per_address);
        let calls = Calls::new(config.calls_per_second, config.calls_at_once);
        Self(Arc::new(Rules { config, places, calls, cut: CancellationToken::new() }))
    }

    pub(crate) fn config(&self) -> &ConnectionsConfig {
        &self.0.config
    }

    /// Ends every connection, whatever is under way on it.
    pub(crate) fn cut(&self) {
        self.0.cut.cancel();
    }

    /// The connections that come in on `listener` without a handshake of their own.
    pub(crate) fn plain(&self, listener: TcpListener) -> Incoming<tokio::net::TcpStream> {
        incoming(self, listener, |stream| std::future::ready(Ok(stream)))
    }

    /// What counts and limits calls.
    pub(crate) fn layer(&self) -> CallsLayer {
        CallsLayer::new(self.clone())
    }
}
