//! The edge of a gRPC server: limits on open connections, on the time for which a peer may be silent or slow, and on
//! calls. The transport has none of these limits.
//!
//! [`Connections`] has the limits for every connection of a listener. [`Connections::accept`] returns the connections
//! that got a permit and completed the handshake ([`Tls`]), each watched: it ends when its peer makes no first call,
//! reads nothing, or leaves a response unread for too long. [`Connections::layer`] watches the calls on them: requests
//! and responses must keep a minimum rate, and unary calls of one client queue behind each other.
//! [`Connections::count`] limits the calls of a client.
//!
//! Depends on bytes, addresses, tonic and the paths of calls. No other crate of the workspace is named here; the caller
//! defines the meaning of a call and the client behind a key. Numbers go to the `metrics` crate.

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
