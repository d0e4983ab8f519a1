//! Serving of policies.

use std::time::Duration;

use clap::Args;

/// Serving of policies.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Policies")]
pub struct PoliciesConfig {
    /// Maximum number of observations in one batch of a model, at least 1. Larger batches raise throughput and latency.
    #[arg(long, env = "GLEANER_POLICY_BATCH", default_value_t = 16, value_name = "N")]
    pub policy_batch: usize,
    /// Maximum wait of an idle model for more observations, as a fraction of the fastest session's control period, 0 to
    /// 0.5. Waiting forms larger batches at the cost of latency (0: no wait).
    #[arg(long, env = "GLEANER_POLICY_BATCH_WAIT", default_value_t = 0.05, value_name = "FRACTION")]
    pub policy_batch_wait: f64,
    /// Microseconds for which a model's thread spins for the next request before it sleeps, where the one before came
    /// within that time. Lowers the latency of closed-loop simulators at the cost of one busy core; 0 disables.
    #[arg(long, env = "GLEANER_POLICY_SPIN_US", default_value_t = 1000, value_name = "MICROSECONDS")]
    pub policy_spin_us: u64,
    /// Threads that carry messages between clients and models (0: half of the processors). Each model has a thread of
    /// its own; more message threads take processors from the models.
    #[arg(long, env = "GLEANER_IO_THREADS", default_value_t = 0, value_name = "N")]
    pub io_threads: usize,
    /// Maximum number of requests queued for one policy, at least 1; further ones are rejected. A longer queue absorbs
    /// bursts at the cost of latency.
    #[arg(long, env = "GLEANER_POLICY_QUEUE", default_value_t = 256, value_name = "N")]
    pub policy_queue: usize,
    /// Maximum size of loaded checkpoints in bytes. Beyond it, least recently used policies without a session are
    /// unloaded until their next use, which then takes longer.
    #[arg(long, env = "GLEANER_POLICY_MEMORY_BYTES", default_value_t = 4 << 30, value_name = "BYTES")]
    pub policy_memory_bytes: u64,
    /// Maximum number of score runs that stay loaded for live scores without a session. Beyond it, the least recently
    /// used are unloaded; loading one again encodes its experts.
    #[arg(long, env = "GLEANER_LIVE_SCORERS", default_value_t = 2, value_name = "N")]
    pub live_scorers: usize,
    /// End a session whose robot sends or reads nothing for this many seconds, 1 to 86400.
    #[arg(long, env = "GLEANER_SESSION_IDLE_SECONDS", default_value_t = 60, value_name = "SECONDS")]
    pub session_idle_seconds: u64,
}

impl PoliciesConfig {
    /// Threads that carry messages: the setting, or half of the processors.
    pub fn io_threads(&self) -> usize {
        match self.io_threads {
            0 => std::thread::available_parallelism().map_or(1, |all| (all.get() / 2).max(1)),
            threads => threads,
        }
    }

    /// The longest time for which a model's thread spins for the next request.
    pub fn policy_spin(&self) -> Duration {
        Duration::from_micros(self.policy_spin_us)
    }

    /// The time for which a robot may be silent.
    pub fn session_idle(&self) -> Duration {
        Duration::from_secs(self.session_idle_seconds)
    }

    /// Checks ranges.
    ///
    /// # Errors
    /// A sentence that names the flag and the range.
    pub fn validate(&self) -> Result<(), String> {
        if self.policy_batch == 0 || self.policy_queue == 0 {
            return Err("--policy-batch and --policy-queue: must be at least 1".to_owned());
        }
        if self.io_threads > 1024 {
            return Err("--io-threads: must be at most 1024".to_owned());
        }
        if !(0.0..=0.5).contains(&self.policy_batch_wait) {
            return Err("--policy-batch-wait: must be between 0 and 0.5 of a control period".to_owned());
        }
        if self.policy_spin_us > 100_000 {
            return Err("--policy-spin-us: must be at most 100000".to_owned());
        }
        if !(1..=86_400).contains(&self.session_idle_seconds) {
            return Err("--session-idle-seconds: must be between 1 and 86400".to_owned());
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Parser)]
    struct Alone {
        #[command(flatten)]
        policies: PoliciesConfig,
    }

    fn with(args: &[&str]) -> PoliciesConfig {
        Alone::try_parse_from([&["serve"], args].concat()).unwrap().policies
    }

    #[test]
    fn io_threads_default_to_half_of_the_processors() {
        let processors = std::thread::available_parallelism().unwrap().get();
        assert_eq!(with(&[]).io_threads(), (processors / 2).max(1));
        assert_eq!(with(&["--io-threads", "3"]).io_threads(), 3);
        assert!(with(&["--io-threads", "5000"]).validate().unwrap_err().starts_with("--io-threads: "));
    }
}
