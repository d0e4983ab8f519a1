//! The limits of the edge, as plain values. Must not depend on the source of the configuration.

use std::time::Duration;

use tonic::Status;

use crate::error::EdgeError;

/// The limits on connections and calls.
#[derive(Debug, Clone)]
pub struct EdgeConfig {
    /// Maximum number of open connections; further ones are closed on arrival.
    pub max_connections: usize,
    /// Maximum number of open connections from one peer key (IPv4 address or IPv6 /64).
    pub max_connections_per_address: usize,
    /// Time for a new connection to finish its handshake and make its first call.
    pub first_call: Duration,
    /// Time without any byte, including the reply to a ping, after which a peer counts as lost.
    pub keepalive_timeout: Duration,
    /// Time for which a peer may read nothing of what is sent, or read a response below the minimum rate.
    pub write_timeout: Duration,
    /// Minimum rate of a request and of a response.
    pub min_bytes_per_second: u32,
    /// Time for which a request may stay below the minimum rate.
    pub slow: Duration,
    /// Calls per second of one client; twice as many may come in a burst, further ones are rejected.
    pub calls_per_second: u32,
    /// Maximum number of calls of one client that run at the same time.
    pub calls_at_once: usize,
    /// Unary calls per second of one client; twice as many may come in a burst, further ones wait.
    pub unary_calls_per_second: u32,
    /// Maximum number of unary calls of one client that run at the same time; further ones wait.
    pub unary_calls_at_once: usize,
}

impl EdgeConfig {
    /// Interval between pings to a silent peer: two thirds of the keep-alive timeout; the rest is for the reply.
    pub fn ping_interval(&self) -> Duration {
        self.keepalive_timeout * 2 / 3
    }

    /// Time for the reply to a ping.
    pub fn ping_timeout(&self) -> Duration {
        self.keepalive_timeout / 3
    }
}

/// Properties of calls by their path, and the status of a call that the edge ends.
#[derive(Debug, Clone, Copy)]
pub struct CallRules {
    /// Whether a call is unary and short, so that it may queue behind others of its client.
    pub is_unary: fn(&str) -> bool,
    /// Whether the request is exempt from the minimum rate because its sender sets the pace.
    pub is_self_paced: fn(&str) -> bool,
    /// The status of a call that the edge ends.
    pub status: fn(EdgeError) -> Status,
}
