//! The edge of a gRPC server: limits on connections, on slow and silent peers, and on the calls of a client, which the
//! transport does not have.
//!
//! - [`Connections`] has the limits ([`EdgeConfig`]) of a listener and the rules of its calls ([`CallRules`]).
//! - [`Connections::accept`] returns the connections that received a permit and completed their handshake ([`Tls`]). Each is
//!   closed if its peer makes no first call, reads nothing, or leaves a response unread for too long.
//! - [`Connections::layer`] limits the calls on them: requests and responses keep a minimum rate, and unary calls of one
//!   client are queued behind each other.
//! - [`Connections::count`] limits the number of calls of a client, which a [`ClientKey`] identifies.
//!
//! The crate depends on no other crate of the workspace; the caller defines the meaning of calls and clients. Counters go to
//! the `metrics` crate.
//!
//! ```no_run
//! use std::{net::IpAddr, sync::Arc};
//!
//! use gleaner_edge::{CallRules, Connections, EdgeConfig, Protocol, Tls};
//! use tokio::net::TcpListener;
//!
//! # async fn listen(config: EdgeConfig, rules: CallRules, tls: Option<Arc<Tls>>) -> std::io::Result<()> {
//! let connections = Connections::<IpAddr>::new(config, rules);
//! let listener = TcpListener::bind("127.0.0.1:7400").await?;
//! let incoming = connections.accept(listener, tls, Protocol::Http2);
//! // A tonic server gets `layer` and serves `incoming`.
//! let layer = connections.layer();
//! # drop((incoming, layer));
//! # Ok(())
//! # }
//! ```

mod accept;
mod body;
mod calls;
mod config;
mod connection;
mod connections;
mod error;
mod layer;
mod pending;
mod permits;
mod rate;
mod rules;
mod state;
#[cfg(test)]
mod tests;
mod tls;

pub use accept::Incoming;
pub use body::ResponseBody;
pub use calls::{Call, ClientKey};
pub use config::{CallRules, EdgeConfig};
pub use connection::Connection;
pub use connections::{Connections, raise_descriptor_limit};
pub use error::{EdgeError, TlsFile};
pub use layer::{CallsLayer, CallsService, refuse};
pub use state::ConnectionState;
pub use tls::{Protocol, Tls, TlsFiles, Transport};
