//! Limits on connections and calls of one peer, and on silent and slow peers.

use std::time::Duration;

use clap::Args;

/// Limits on connections and calls.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Connections and calls")]
pub struct ConnectionsConfig {
    /// Maximum number of open connections; further ones are closed at once. Each one needs a file descriptor.
    #[arg(long, env = "GLEANER_MAX_CONNECTIONS", default_value_t = 4096, value_name = "N")]
    pub max_connections: usize,
    /// Maximum number of open connections from one address (IPv6: one /64). A low limit stops one machine from using
    /// them all; clients behind one NAT share it.
    #[arg(long, env = "GLEANER_MAX_CONNECTIONS_PER_ADDRESS", default_value_t = 2048, value_name = "N")]
    pub max_connections_per_address: usize,
    /// Close a new connection that has not finished its handshake and made a call within this many seconds.
    #[arg(long, env = "GLEANER_FIRST_CALL_SECONDS", default_value_t = 8, value_name = "S")]
    pub first_call_seconds: u64,
    /// Seconds without a word, not even an answer to a ping, after which a peer is gone.
    #[arg(long, env = "GLEANER_LOST_SECONDS", default_value_t = 30, value_name = "S")]
    pub lost_seconds: u64,
    /// Seconds for which a peer may take none of what is sent to it, or less of an answer than the least rate says.
    #[arg(long, env = "GLEANER_STALL_SECONDS", default_value_t = 30, value_name = "S")]
    pub stall_seconds: u64,
    /// Minimum rate in bytes per second at which a request or upload must arrive, sessions excepted, and a response
    /// must be read. Higher values free resources from slow peers sooner but cut off bad links.
    #[arg(long, env = "GLEANER_MIN_BYTES_PER_SECOND", default_value_t = 4096, value_name = "N")]
    pub min_bytes_per_second: u32,
    /// Close a request or upload below `--min-bytes-per-second` for this many seconds.
    #[arg(long, env = "GLEANER_SLOW_SECONDS", default_value_t = 8, value_name = "S")]
    pub slow_seconds: u64,
    /// Maximum rate of short calls per second of one token, or of one address without a token; bursts of twice as many
    /// are allowed and further ones are queued. Short calls are all but sessions, actions, deployments and transfers.
    #[arg(long, env = "GLEANER_QUESTIONS_PER_SECOND", default_value_t = 350, value_name = "N")]
    pub questions_per_second: u32,
    /// Maximum number of short calls of one token or address that run at once; further ones are queued. More let one
    /// client use all readers of the database.
    #[arg(long, env = "GLEANER_QUESTIONS_IN_HAND", default_value_t = 3, value_name = "N")]
    pub questions_in_hand: usize,
    /// Maximum rate of calls per second of one token, or of one address without a token; bursts of twice as many are
    /// allowed and further ones are rejected.
    #[arg(long, env = "GLEANER_CALLS_PER_SECOND", default_value_t = 1000, value_name = "N")]
    pub calls_per_second: u32,
    /// Maximum number of calls of one token or address that run at once, sessions included; further ones are rejected.
    #[arg(long, env = "GLEANER_CALLS_AT_ONCE", default_value_t = 2048, value_name = "N")]
    pub calls_at_once: usize,
}

impl ConnectionsConfig {
    /// The time in which a new connection must make its first call.
    pub fn first_call(&self) -> Duration {
        Duration::from_secs(self.first_call_seconds)
    }

    /// The interval of pings to a silent peer: two thirds of the time after which it is closed.
    pub fn ping_every(&self) -> Duration {
        Duration::from_secs(self.lost_seconds) * 2 / 3
    }

    /// The time allowed for the response to a ping.
    pub fn ping_timeout(&self) -> Duration {
        Duration::from_secs(self.lost_seconds) / 3
    }

    /// The time for which a peer may read nothing.
    pub fn stall(&self) -> Duration {
        Duration::from_secs(self.stall_seconds)
    }

    /// The time for which a request may be below the minimum rate.
    pub fn slow(&self) -> Duration {
        Duration::from_secs(self.slow_seconds)
    }

    /// Checks ranges.
    ///
    /// # Errors
    /// A sentence that names the flag and the range.
    pub fn validate(&self) -> Result<(), String> {
        for (flag, seconds) in [
            ("--first-call-seconds", self.first_call_seconds),
            ("--lost-seconds", self.lost_seconds),
            ("--stall-seconds", self.stall_seconds),
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
            ("--questions-per-second", self.questions_per_second == 0),
            ("--questions-in-hand", self.questions_in_hand == 0),
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
            lost_seconds: 30,
            stall_seconds: 30,
            min_bytes_per_second: 4096,
            slow_seconds: 8,
            calls_per_second: 1000,
            calls_at_once: 2048,
            questions_per_second: 350,
            questions_in_hand: 3,
        }
    }
}
