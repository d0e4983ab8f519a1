//! The results of an evaluation in the simulator.

use std::time::Duration;

use gleaner_core::statistics;

use crate::error::{ClientError, Result};
use crate::lowest::LowestScore;
use crate::robot::ControlReport;

/// One simulated episode.
#[derive(Clone, Debug, PartialEq)]
pub struct DrivenEpisode {
    /// The simulator's seed.
    pub seed: u64,
    /// Whether the task was solved.
    pub success: bool,
    /// Steps taken.
    pub steps: u32,
    /// The recorded episodes: one, except for a real-time run that lost the server.
    pub episode_ids: Vec<String>,
    /// The lowest live score, if the deployment names a score run.
    pub lowest: Option<LowestScore>,
}

/// The result of an evaluation.
#[derive(Clone, Debug)]
pub struct Driven {
    /// In the order of their seeds.
    pub episodes: Vec<DrivenEpisode>,
    /// The policy of the sessions.
    pub policy_id: String,
    /// Latencies from observation to action, sorted; empty in real time, where the loop does not wait.
    pub latencies: Vec<Duration>,
    /// The duration of the evaluation.
    pub wall: Duration,
    /// The real-time report over all episodes.
    pub control: Option<ControlReport>,
}

impl Driven {
    /// Episodes that were solved.
    #[must_use]
    pub fn successes(&self) -> u32 {
        self.episodes.iter().map(|episode| u32::from(episode.success)).sum()
    }

    /// Share of episodes that were solved, 0 when there were none.
    #[must_use]
    pub fn success_rate(&self) -> f64 {
        f64::from(self.successes()) / f64::from(self.total().max(1))
    }

    /// 95 % Wilson interval of the success rate.
    #[must_use]
    pub fn interval(&self) -> (f64, f64) {
        statistics::wilson(self.successes(), self.total())
    }

    /// Steps over all episodes.
    #[must_use]
    pub fn steps(&self) -> u64 {
        self.episodes.iter().map(|episode| u64::from(episode.steps)).sum()
    }

    /// The latency quantile for a share (0 to 1) of the steps (nearest rank).
    #[must_use]
    pub fn latency(&self, share: f64) -> Duration {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            clippy::cast_precision_loss,
            reason = "a share of a length is an index; the cast saturates"
        )]
        let rank = (share.clamp(0.0, 1.0) * self.latencies.len() as f64).ceil() as usize;
        self.latencies.get(rank.saturating_sub(1)).copied().unwrap_or_default()
    }

    /// The number of episodes that the server stored.
    #[must_use]
    pub fn recorded(&self) -> usize {
        self.episodes.iter().map(|episode| episode.episode_ids.len()).sum()
    }

    /// Refuses a session of another policy than the others: their episodes are not the result of one.
    pub(super) fn expect_policy(&mut self, deployment: &str, policy_id: String) -> Result<()> {
        if self.policy_id.is_empty() {
            self.policy_id = policy_id;
        } else if self.policy_id != policy_id {
            return Err(ClientError::Invalid(format!(
                "{deployment} was changed from {} to {policy_id} during the evaluation, whose result would be of neither; \
                 start it again",
                self.policy_id
            )));
        }
        Ok(())
    }

    fn total(&self) -> u32 {
        u32::try_from(self.episodes.len()).unwrap_or(u32::MAX)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn episode(seed: u64, success: bool) -> DrivenEpisode {
        DrivenEpisode { seed, success, steps: 10, episode_ids: Vec::new(), lowest: None }
    }

    fn driven(outcomes: &[bool], latencies_ms: &[u64]) -> Driven {
        Driven {
            episodes: (0..).zip(outcomes).map(|(seed, &success)| episode(seed, success)).collect(),
            policy_id: String::new(),
            latencies: latencies_ms.iter().map(|&ms| Duration::from_millis(ms)).collect(),
            wall: Duration::ZERO,
            control: None,
        }
    }

    #[test]
    fn rates_and_percentiles_match_the_episodes() {
        let result = driven(&[true, false, true, true], &(1..=100).collect::<Vec<_>>());
        assert_eq!((result.successes(), result.steps()), (3, 40));
        assert!((result.success_rate() - 0.75).abs() < 1e-12);
        let (low, high) = result.interval();
        assert!(low < 0.75 && 0.75 < high);
        assert_eq!(result.latency(0.5), Duration::from_millis(50));
        assert_eq!(result.latency(0.99), Duration::from_millis(99));
        assert_eq!(result.latency(1.0), Duration::from_millis(100));
    }

    #[test]
    fn an_evaluation_has_one_policy() {
        let mut result = driven(&[], &[]);
        for _ in 0..2 {
            result.expect_policy("pick@prod", "pol_1".into()).unwrap();
        }
        let message = result.expect_policy("pick@prod", "pol_2".into()).unwrap_err().to_string();
        assert!(message.starts_with("pick@prod was changed from pol_1 to pol_2"), "{message}");
        assert_eq!(result.policy_id, "pol_1");
    }

    #[test]
    fn an_empty_evaluation_does_not_divide_by_zero() {
        let result = driven(&[], &[]);
        assert!(result.success_rate().abs() < f64::EPSILON);
        assert_eq!(result.latency(0.99), Duration::ZERO);
        assert_eq!(result.interval(), (0.0, 1.0));
    }
}
