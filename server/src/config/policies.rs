//! How policies are served.

use std::time::Duration;

use clap::Args;

/// How policies are served.
#[derive(Debug, Clone, Args)]
pub struct PoliciesConfig {
    /// Most observations answered in one pass of a model.
    #[arg(long, env = "GLEANER_POLICY_BATCH", default_value_t = 16)]
    pub policy_batch: usize,
    /// How long a free model may wait for other sessions to share its pass, as a part of the fastest one's control
    /// period; 0: not at all.
    #[arg(long, env = "GLEANER_POLICY_BATCH_WAIT", default_value_t = 0.05)]
    pub policy_batch_wait: f64,
    /// Microseconds for which a model's thread spins for the next request before it sleeps, where the one before came
    /// within that time. Lowers the latency of closed-loop simulators at the cost of one busy core; 0 disables.
    #[arg(long, env = "GLEANER_POLICY_SPIN_US", default_value_t = 1000, value_name = "MICROSECONDS")]
    pub policy_spin_us: u64,
    /// Threads that carry messages between robots and models; 0: half of the processors. The others are for the
    /// models, one thread each: a message that wakes a second thread where a model runs costs more than it gains.
    #[arg(long, env = "GLEANER_IO_THREADS", default_value_t = 0, value_name = "N")]
    pub io_threads: usize,
    /// Requests that may wait for one policy.
    #[arg(long, env = "GLEANER_POLICY_QUEUE", default_value_t = 256)]
    pub policy_queue: usize,
    /// Bytes of checkpoints to hold in memory. Beyond, the least recently used policies that no session holds are
    /// unloaded until their next use.
    #[arg(long, env = "GLEANER_POLICY_MEMORY_BYTES", default_value_t = 4 << 30)]
    pub policy_memory_bytes: u64,
    /// Score runs to keep ready for live scores when no session uses them; beyond, the least recently used are unloaded.
    #[arg(long, env = "GLEANER_LIVE_SCORERS", default_value_t = 2, value_name = "N")]
    pub live_scorers: usize,
    /// Seconds after which a session whose robot says nothing, or reads nothing, is over.
    #[arg(long, env = "GLEANER_SESSION_IDLE_SECONDS", default_value_t = 60)]
    pub session_idle_seconds: u64,
}

impl PoliciesConfig {
    /// Threads that carry messages: as set, or half of the processors.
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

    /// How long a robot may be silent.
    pub fn session_idle(&self) -> Duration {
        Duration::from_secs(self.session_idle_seconds)
    }

    /// Checks what the types cannot tell.
    ///
    /// # Errors
    /// A sentence that names the flag and the fix.
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
    fn half_of_the_processors_carry_messages_unless_it_is_said() {
        let processors = std::thread::available_parallelism().unwrap().get();
        assert_eq!(with(&[]).io_threads(), (processors / 2).max(1));
        assert_eq!(with(&["--io-threads", "3"]).io_threads(), 3);
        assert!(with(&["--io-threads", "5000"]).validate().unwrap_err().starts_with("--io-threads: "));
    }
}
