//! Limits on connections and calls: how much of the server one peer may use, and how long it may be silent or slow.

use std::time::Duration;

use clap::Args;
use gleaner_edge::EdgeConfig;

/// Limits on connections and calls.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Connections and calls")]
pub struct ConnectionsConfig {
    /// Maximum number of open connections, at least 1; further ones are closed on arrival. Each takes memory and a file
    /// descriptor.
    #[arg(long, env = "GLEANER_MAX_CONNECTIONS", default_value_t = 4096, value_name = "N")]
    pub max_connections: usize,
    /// Maximum number of open connections from one address (for IPv6: from one /64), at least 1. A low limit bounds the
    /// share of one machine; a high one serves many clients behind one address.
    #[arg(long, env = "GLEANER_MAX_CONNECTIONS_PER_ADDRESS", default_value_t = 2048, value_name = "N")]
    pub max_connections_per_address: usize,
    /// Close a new connection that has not finished its handshake and made a call within this many seconds, 1 to 3600.
    /// Fewer seconds free idle connections sooner but cut off slow networks.
    #[arg(long, env = "GLEANER_FIRST_CALL_SECONDS", default_value_t = 8, value_name = "S")]
    pub first_call_seconds: u64,
    /// Close a connection whose peer sends nothing, not even the reply to a ping, for this many seconds, 1 to 3600.
    /// Fewer seconds detect lost peers sooner but close connections on short network failures.
    #[arg(long, env = "GLEANER_KEEPALIVE_TIMEOUT", default_value_t = 30, value_name = "S")]
    pub keepalive_timeout: u64,
    /// Close a connection whose peer reads nothing, or reads a response below `--min-bytes-per-second`, for this many
    /// seconds, 1 to 3600.
    #[arg(long, env = "GLEANER_WRITE_TIMEOUT", default_value_t = 30, value_name = "S")]
    pub write_timeout: u64,
    /// Minimum rate, in bytes per second, at least 1, at which a request or an upload must be sent and a response be
    /// read. Sessions are exempt. A higher rate frees slow connections sooner but cuts off slow networks.
    #[arg(long, env = "GLEANER_MIN_BYTES_PER_SECOND", default_value_t = 4096, value_name = "N")]
    pub min_bytes_per_second: u32,
    /// End a request or an upload that is below `--min-bytes-per-second` for this many seconds, 1 to 3600. More seconds
    /// tolerate longer pauses of the network.
    #[arg(long, env = "GLEANER_SLOW_SECONDS", default_value_t = 8, value_name = "S")]
    pub slow_seconds: u64,
    /// Maximum number of unary calls per second of one token, or of one address without a token. A burst may have twice
    /// as many; further ones wait. All calls are unary except sessions, actions, deployments and transfers of
    /// recordings.
    #[arg(long, env = "GLEANER_UNARY_CALLS_PER_SECOND", default_value_t = 350, value_name = "N")]
    pub unary_calls_per_second: u32,
    /// Maximum number of concurrent unary calls of one token, or of one address without a token; further ones wait.
    #[arg(long, env = "GLEANER_UNARY_CALLS_AT_ONCE", default_value_t = 3, value_name = "N")]
    pub unary_calls_at_once: usize,
    /// Maximum number of calls per second of one token, or of one address without a token. A burst may have twice as
    /// many; further ones are rejected.
    #[arg(long, env = "GLEANER_CALLS_PER_SECOND", default_value_t = 1000, value_name = "N")]
    pub calls_per_second: u32,
    /// Maximum number of concurrent calls of one token, or of one address without a token; further ones are rejected. A
    /// session is one call.
    #[arg(long, env = "GLEANER_CALLS_AT_ONCE", default_value_t = 2048, value_name = "N")]
    pub calls_at_once: usize,
}

impl ConnectionsConfig {
    /// The limits as the edge takes them.
    pub fn limits(&self) -> EdgeConfig {
        EdgeConfig {
            max_connections: self.max_connections,
            max_connections_per_address: self.max_connections_per_address,
            first_call: Duration::from_secs(self.first_call_seconds),
            keepalive_timeout: Duration::from_secs(self.keepalive_timeout),
            write_timeout: Duration::from_secs(self.write_timeout),
            min_bytes_per_second: self.min_bytes_per_second,
            slow: Duration::from_secs(self.slow_seconds),
            calls_per_second: self.calls_per_second,
            calls_at_once: self.calls_at_once,
            unary_calls_per_second: self.unary_calls_per_second,
            unary_calls_at_once: self.unary_calls_at_once,
        }
    }

    /// Checks the ranges that the types do not.
    ///
    /// # Errors
    /// A message that names the flag and its range.
    pub fn validate(&self) -> Result<(), String> {
        for (flag, seconds) in [
            ("--first-call-seconds", self.first_call_seconds),
            ("--keepalive-timeout", self.keepalive_timeout),
            ("--write-timeout", self.write_timeout),
            ("--slow-seconds", self.slow_seconds),
        ] {
            if !(1..=3600).contains(&seconds) {
                return Err(format!("{flag}: must be between 1 and 3600"));
            }
        }
        for (flag, none) in [
            ("--max-connections", self.max_connections == 0),
            ("--max-connections-per-address", self.max_connections_per_address == 0),
            ("--min-bytes-per-second", self.min_bytes_per_second == 0),
            ("--calls-per-second", self.calls_per_second == 0),
            ("--calls-at-once", self.calls_at_once == 0),
            ("--unary-calls-per-second", self.unary_calls_per_second == 0),
            ("--unary-calls-at-once", self.unary_calls_at_once == 0),
        ] {
            if none {
                return Err(format!("{flag}: must be at least 1"));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
impl Default for ConnectionsConfig {
    fn default() -> Self {
        Self {
            max_connections: 8,
            max_connections_per_address: 4,
            first_call_seconds: 8,
            keepalive_timeout: 30,
            write_timeout: 30,
            min_bytes_per_second: 4096,
            slow_seconds: 8,
            calls_per_second: 1000,
            calls_at_once: 2048,
            unary_calls_per_second: 350,
            unary_calls_at_once: 3,
        }
    }
}
