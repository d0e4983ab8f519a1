//! The edge of a gRPC server: how many connections are open, how long a peer may be silent or slow, and how many calls
//! it may make.
//! The transport limits none of this.
//!
//! [`Connections`] holds the limits for every connection of a listener. [`Connections::accept`] returns the connections
//! that got a permit and shook hands ([`Tls`]), each watched: it ends when its peer makes no first call, reads nothing,
//! or leaves a response unread for too long. [`Connections::layer`] watches the calls on them: requests and responses
//! must keep a minimum rate, and unary calls of one client queue behind each other. [`Connections::count`] limits how
//! many calls a client makes.
//!
//! Knows bytes, addresses, tonic and the paths of calls. No other crate of the workspace is named here, and what a call
//! means or which client a key stands for is the caller's business. Numbers go to the `metrics` crate.

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
