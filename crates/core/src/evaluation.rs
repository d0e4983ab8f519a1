//! Evaluations: closed-loop trials of a policy, and the confidence interval of their success rate.

use super::{
    id::{EvaluationId, JobId, PolicyId},
    time::Millis,
};

/// Trials of one seed.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct SeedResult {
    /// The seed.
    pub seed: u64,
    /// Attempts.
    pub episodes: u32,
    /// Attempts that succeeded.
    pub successes: u32,
    /// Steps of an attempt on average; 0 when unknown.
    pub mean_steps: f64,
}

/// Closed-loop trials of one policy.
#[derive(Debug, Clone, PartialEq)]
pub struct Evaluation {
    /// Its id.
    pub id: EvaluationId,
    /// The policy.
    pub policy_id: PolicyId,
    /// The job that made it; `None` when reported from outside.
    pub job_id: Option<JobId>,
    /// Where the trials ran: the embedded simulator's task, or the reporter's own name.
    pub simulation: String,
    /// Results of each seed.
    pub seeds: Vec<SeedResult>,
    /// When it was stored.
    pub created_at: Millis,
}

/// All seeds of an evaluation together.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Success {
    /// Attempts.
    pub episodes: u32,
    /// Attempts that succeeded.
    pub successes: u32,
    /// Their share; 0 without attempts.
    pub rate: f64,
    /// Wilson 95 % interval of the rate.
    pub interval: (f64, f64),
}

impl Evaluation {
    /// All seeds together.
    pub fn success(&self) -> Success {
        let sum = |of: fn(&SeedResult) -> u32| self.seeds.iter().map(of).fold(0, u32::saturating_add);
        let (episodes, successes) = (sum(|seed| seed.episodes), sum(|seed| seed.successes));
        Success {
            episodes,
            successes,
            rate: f64::from(successes) / f64::from(episodes.max(1)),
            interval: crate::statistics::wilson(successes, episodes),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seeds_are_pooled() {
        let seed = |seed, successes| SeedResult { seed, episodes: 100, successes, mean_steps: 30.0 };
        let evaluation = Evaluation {
            id: EvaluationId::new(),
            policy_id: PolicyId::new(),
            job_id: None,
            simulation: "pick_cube".into(),
            seeds: vec![seed(0, 40), seed(1, 60)],
            created_at: Millis(0),
        };
        let success = evaluation.success();
        assert_eq!((success.episodes, success.successes, success.rate), (200, 100, 0.5));
        assert!(success.interval.0 < 0.5 && success.interval.1 > 0.5 && success.interval.1 < 0.57);
    }
}
