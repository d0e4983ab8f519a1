//! Policies for clients of openpi (DROID, ALOHA, LIBERO): a WebSocket a session, on an address of its own.
//!
//! Knows HTTP, sockets and sessions; the content of messages is in `gleaner-openpi`. Must not know tensors or SQL.

mod http;
mod keepalive;
mod session;
#[cfg(test)]
mod tests;

use std::{sync::Arc, time::Duration};

use futures::StreamExt as _;
use gleaner_edge::{Protocol, Tls};
use tokio::net::TcpListener;
use tokio_util::task::AbortOnDropHandle;

use crate::{
    access::{PageGuard, TokenCache},
    config::ConnectionsConfig,
    connections::connections,
    error::{Error, Result},
    service::Services,
};

/// Connections in total, and from one address: each is a robot.
const CONNECTIONS: usize = 1024;
const CONNECTIONS_PER_ADDRESS: usize = 256;
/// How long a client may take to read one reply.
const READ_WITHIN: Duration = Duration::from_secs(30);

/// The state shared by all connections.
struct Shared {
    services: Services,
    guard: PageGuard,
}

/// Serves clients of openpi until the returned handle is dropped.
///
/// # Errors
/// Internal when the address is gone.
pub(crate) fn open(
    services: Services,
    listener: TcpListener,
    tls: Option<Arc<Tls>>,
    tokens: TokenCache,
) -> Result<AbortOnDropHandle<()>> {
    let address = listener.local_addr().map_err(|error| Error::internal("reading openpi's address", error))?;
    let config = &services.config;
    let loopback = address.ip().is_loopback() && config.listen.ip().is_loopback();
    let required = config.access.tokens_required(loopback, config.insecure);
    let connections = connections(&ConnectionsConfig {
        max_connections: CONNECTIONS,
        max_connections_per_address: CONNECTIONS_PER_ADDRESS,
        ..config.connections.clone()
    });
    let guard = PageGuard::new(tokens, required, connections.clone());
    let shared = Arc::new(Shared { services, guard });
    Ok(AbortOnDropHandle::new(tokio::spawn(async move {
        let mut incoming = connections.accept(listener, tls, Protocol::Http1);
        while let Some(Ok(connection)) = incoming.next().await {
            tokio::spawn(http::serve(connection, Arc::clone(&shared)));
        }
    })))
}
