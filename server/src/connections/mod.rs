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
mod offer;
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
    calls::Call,
    guarded::Guarded,
    layer::{CallsLayer, refused},
    link::Link,
};
use self::{calls::Calls, places::Places};
use crate::{config::ConnectionsConfig, domain::client::Client, error::Result};

/// Descriptors that are not for connections: the database, blobs, pipes to children.
const SPARED: u64 = 256;

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

/// How many of `asked` connections the limit on descriptors leaves room for; `None` is no limit.
fn affordable(asked: usize, descriptors: Option<u64>) -> usize {
    let room = descriptors.map_or(u64::MAX, |limit| limit.saturating_sub(SPARED).max(1));
    asked.min(usize::try_from(room).unwrap_or(usize::MAX))
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
        let most = affordable(config.max_connections, getrlimit(Resource::Nofile).current);
        if most < config.max_connections {
            tracing::warn!(
                connections.most = most,
                connections.asked = config.max_connections,
                "the limit on open files (ulimit -n) leaves no room for --max-connections"
            );
        }
        let places = Places::new(most, config.max_connections_per_address);
        let calls = Calls::new(&config);
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

    /// Counts a call for its client.
    ///
    /// # Errors
    /// Exhausted, saying when to try again.
    pub(crate) fn count(&self, client: Client) -> Result<Call> {
        self.0.calls.begin(client)
    }

    /// What watches calls.
    pub(crate) fn layer(&self) -> CallsLayer {
        CallsLayer::new(self.clone())
    }
}
