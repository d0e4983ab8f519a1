//! How much of the server one peer may take: connections, calls, and how long it may be silent or slow.

use std::time::Duration;

use clap::Args;

/// How much of the server one peer may take.
#[derive(Debug, Clone, Args)]
pub struct ConnectionsConfig {
    /// Most connections at once; further ones are closed as they come.
    #[arg(long, env = "GLEANER_MAX_CONNECTIONS", default_value_t = 4096, value_name = "N")]
    pub max_connections: usize,
    /// Most connections at once from one address (for IPv6: from one /64).
    #[arg(long, env = "GLEANER_MAX_CONNECTIONS_PER_ADDRESS", default_value_t = 2048, value_name = "N")]
    pub max_connections_per_address: usize,
    /// Seconds within which a new connection must have greeted and made its first call.
    #[arg(long, env = "GLEANER_FIRST_CALL_SECONDS", default_value_t = 8, value_name = "S")]
    pub first_call_seconds: u64,
    /// Seconds without a word, not even an answer to a ping, after which a peer is gone.
    #[arg(long, env = "GLEANER_LOST_SECONDS", default_value_t = 30, value_name = "S")]
    pub lost_seconds: u64,
    /// Seconds for which a peer may take none of what is sent to it, or less of an answer than the least rate says.
    #[arg(long, env = "GLEANER_STALL_SECONDS", default_value_t = 30, value_name = "S")]
    pub stall_seconds: u64,
    /// Fewest bytes per second in which a request or an upload must come in, sessions aside, and an answer be taken.
    #[arg(long, env = "GLEANER_MIN_BYTES_PER_SECOND", default_value_t = 4096, value_name = "N")]
    pub min_bytes_per_second: u32,
    /// Seconds for which a request or an upload may be slower than that, or stand still.
    #[arg(long, env = "GLEANER_SLOW_SECONDS", default_value_t = 8, value_name = "S")]
    pub slow_seconds: u64,
    /// Questions per second of one token, or of one address without tokens; twice as many may come at once, and further
    /// ones wait. Questions are all calls but sessions, actions, deployments and what carries recordings.
    #[arg(long, env = "GLEANER_QUESTIONS_PER_SECOND", default_value_t = 350, value_name = "N")]
    pub questions_per_second: u32,
    /// Questions of one token, or of one address without tokens, that are in hand at a time; further ones wait for their
    /// turn.
    #[arg(long, env = "GLEANER_QUESTIONS_IN_HAND", default_value_t = 3, value_name = "N")]
    pub questions_in_hand: usize,
    /// Calls per second of one token, or of one address without tokens; twice as many may come at once, and further ones
    /// are refused.
    #[arg(long, env = "GLEANER_CALLS_PER_SECOND", default_value_t = 1000, value_name = "N")]
    pub calls_per_second: u32,
    /// Calls of one token, or of one address without tokens, that may run at once; a session is one.
    #[arg(long, env = "GLEANER_CALLS_AT_ONCE", default_value_t = 2048, value_name = "N")]
    pub calls_at_once: usize,
}

impl ConnectionsConfig {
    /// Within which a new connection must have made its first call.
    pub fn first_call(&self) -> Duration {
        Duration::from_secs(self.first_call_seconds)
    }

    /// How often a peer that says nothing is pinged: two thirds of its patience are for this, one is for the answer.
    pub fn ping_every(&self) -> Duration {
        Duration::from_secs(self.lost_seconds) * 2 / 3
    }

    /// How long the answer to a ping may take.
    pub fn ping_timeout(&self) -> Duration {
        Duration::from_secs(self.lost_seconds) / 3
    }

    /// For how long a peer may take nothing.
    pub fn stall(&self) -> Duration {
        Duration::from_secs(self.stall_seconds)
    }

    /// For how long a request may be slower than the least rate.
    pub fn slow(&self) -> Duration {
        Duration::from_secs(self.slow_seconds)
    }

    /// Checks what the types cannot tell.
    ///
    /// # Errors
    /// A sentence that names the flag and the mend.
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
