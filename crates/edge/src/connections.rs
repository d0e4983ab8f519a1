//! The limits of all connections of a listener, and the functions that apply them to connections and calls. Must not
//! depend on the meaning of a call.

use std::sync::Arc;

use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;

use crate::{
    accept::{Incoming, incoming},
    body::ResponseBody,
    calls::{Call, Calls, ClientKey},
    config::{CallRules, EdgeConfig},
    error::EdgeError,
    layer::CallsLayer,
    permits::Permits,
    rules::Rules,
    state::ConnectionState,
    tls::{Protocol, Tls, Transport, handshake},
};

/// Descriptors kept for other uses: databases, files, pipes to children.
const SPARED: u64 = 256;

/// Raises the limit on file descriptors to the most this process may have: each connection needs one, and the usual
/// initial limit is a thousand.
pub fn raise_descriptor_limit() {
    let limits = getrlimit(Resource::Nofile);
    if limits.current < limits.maximum || limits.maximum.is_none() {
        let raised = Rlimit { current: limits.maximum, maximum: limits.maximum };
        if let Err(error) = setrlimit(Resource::Nofile, raised) {
            tracing::warn!(%error, "the limit on open files stays as it was");
        }
    }
}

/// Number of connections, at most `requested`, that the limit on descriptors has room for; `None` is no limit.
pub(crate) fn affordable(requested: usize, descriptors: Option<u64>) -> usize {
    let room = descriptors.map_or(u64::MAX, |limit| limit.saturating_sub(SPARED).max(1));
    requested.min(usize::try_from(room).unwrap_or(usize::MAX))
}

/// The limits of a listener and its open connections; clones share them. `K` identifies the client of a call.
pub struct Connections<K: ClientKey> {
    rules: Arc<Rules>,
    calls: Arc<Calls<K>>,
}

impl<K: ClientKey> Clone for Connections<K> {
    fn clone(&self) -> Self {
        Self { rules: Arc::clone(&self.rules), calls: Arc::clone(&self.calls) }
    }
}

impl<K: ClientKey> Connections<K> {
    /// Limits for one listener. Warns when the limit on open files leaves no room for all connections.
    pub fn new(config: EdgeConfig, call_rules: CallRules) -> Self {
        let most = affordable(config.max_connections, getrlimit(Resource::Nofile).current);
        if most < config.max_connections {
            tracing::warn!(
                connections.most = most,
                connections.requested = config.max_connections,
                "the limit on open files (ulimit -n) leaves no room for max-connections"
            );
        }
        let permits = Permits::new(most, config.max_connections_per_address);
        let calls = Arc::new(Calls::new(&config));
        Self { rules: Arc::new(Rules { config, call_rules, permits, cut: CancellationToken::new() }), calls }
    }

    /// The limits.
    pub fn config(&self) -> &EdgeConfig {
        &self.rules.config
    }

    #[cfg(test)]
    pub(crate) fn rules(&self) -> &Arc<Rules> {
        &self.rules
    }

    /// Ends every connection, including those with running calls.
    pub fn cut(&self) {
        self.rules.cut.cancel();
    }

    /// Accepts connections on `listener`, encrypted if there is `tls`.
    pub fn accept(&self, listener: TcpListener, tls: Option<Arc<Tls>>, protocol: Protocol) -> Incoming<Transport> {
        incoming(&self.rules, listener, move |stream| handshake(tls.clone(), protocol, stream))
    }

    /// Counts a call for its client; it runs until the result is dropped.
    ///
    /// # Errors
    /// [`EdgeError::CallRate`] or [`EdgeError::CallsAtOnce`].
    pub fn count(&self, client: K) -> Result<Call, EdgeError> {
        self.calls.begin(client)
    }

    /// The layer that watches the requests and responses of calls.
    pub fn layer(&self) -> CallsLayer {
        CallsLayer::new(Arc::clone(&self.rules))
    }

    /// A watched response body, whose call runs until the body is dropped: for responses outside of [`Self::layer`].
    pub fn response<B>(&self, body: B, connection: &ConnectionState, call: Call) -> ResponseBody<B> {
        ResponseBody::new(body, self.rules.piece(), Some(connection.pending().begin()), Some(call))
    }
}
