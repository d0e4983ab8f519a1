//! Evaluations: closed-loop trials of a policy, and how sure their success rate is.

use gleaner_learn::Device;
use gleaner_recording::TaskSpec;
use gleaner_sim::{SimConfig, SimError, Task, compatible, compatible_with};

use super::{
    id::{EvaluationId, JobId, PolicyId},
    time::Millis,
};

/// Attempts of a seed that does not say how many.
pub const EPISODES: u32 = 200;
/// Steps after which an attempt has failed, unless told.
pub const MAX_STEPS: u32 = 60;
/// Seeds are below this, so that none shares an attempt with another.
const SEED_LIMIT: u64 = u32::MAX as u64;

/// Settings of trials in the embedded simulator.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct EvaluateSpec {
    /// The simulator's task.
    pub simulation: String,
    /// Attempts of each seed.
    pub episodes: u32,
    /// Seeds, each once.
    pub seeds: Vec<u64>,
    /// Steps after which an attempt has failed.
    pub max_steps: u32,
    /// Where the policy runs.
    pub device: Device,
}

impl EvaluateSpec {
    /// The first field that is out of range, with the mend.
    ///
    /// # Errors
    /// (field, what is wrong).
    pub fn validate(&self) -> Result<(), (&'static str, String)> {
        let total = u64::from(self.episodes) * self.seeds.len() as u64;
        if self.episodes == 0 || total > 1_000_000 {
            return Err(("episodes", format!("make {total} attempts in all, must be between 1 and 1000000")));
        }
        if !(1..=10_000).contains(&self.max_steps) {
            return Err(("max_steps", format!("is {}, must be between 1 and 10000", self.max_steps)));
        }
        if self.seeds.is_empty() || self.seeds.len() > 1000 {
            return Err(("seeds", format!("are {}, must be between 1 and 1000", self.seeds.len())));
        }
        if let Some(seed) = self.seeds.iter().find(|&&seed| seed >= SEED_LIMIT) {
            return Err(("seeds", format!("hold {seed}, each must be below {SEED_LIMIT}")));
        }
        match self.seeds.iter().enumerate().find(|(at, seed)| self.seeds[..*at].contains(seed)) {
            Some((_, seed)) => Err(("seeds", format!("hold {seed} twice; name each seed once"))),
            None => Ok(()),
        }
    }

    /// The simulator's seeds of a seed's attempts, 2³² · (seed + 1) and on: no two seeds share one, and none is
    /// that of a small recorded set.
    pub fn attempts(&self, seed: u64) -> impl Iterator<Item = u64> + use<> {
        let first = seed.saturating_add(1).saturating_mul(1 << 32);
        (0..u64::from(self.episodes)).map(move |attempt| first.saturating_add(attempt))
    }
}

/// The simulator's task of that name, or of the spec's own if it is empty, with its settings for this task.
///
/// # Errors
/// Why the task cannot be simulated, and the mend.
pub fn simulated(spec: &TaskSpec, simulation: &str) -> Result<(Task, SimConfig), SimError> {
    if simulation.is_empty() {
        return compatible(spec);
    }
    let task: Task = simulation.parse()?;
    Ok((task, compatible_with(task, spec)?))
}

/// Trials of one seed.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct SeedResult {
    /// The seed.
    pub seed: u64,
    /// Attempts.
    pub episodes: u32,
    /// Attempts that succeeded.
    pub successes: u32,
    /// Steps of an attempt on average; 0 when not known.
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
    /// Where: the embedded simulator's task, or the reporter's own name.
    pub simulation: String,
    /// What came of each seed.
    pub seeds: Vec<SeedResult>,
    /// When it was kept.
    pub created_at: Millis,
}

/// All seeds of an evaluation together.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Success {
    /// Attempts.
    pub episodes: u32,
    /// Attempts that succeeded.
    pub successes: u32,
    /// Their share; 0 when nothing was tried.
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
            interval: gleaner_sim::statistics::wilson(successes, episodes),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spec() -> EvaluateSpec {
        EvaluateSpec {
            simulation: String::new(),
            episodes: EPISODES,
            seeds: vec![0, 7],
            max_steps: MAX_STEPS,
            device: Device::Cpu,
        }
    }

    #[test]
    fn no_two_seeds_share_an_attempt() {
        let spec = EvaluateSpec { episodes: 3, ..spec() };
        assert_eq!(spec.attempts(0).collect::<Vec<_>>(), [1 << 32, (1 << 32) + 1, (1 << 32) + 2]);
        assert_eq!(spec.attempts(1).next(), Some(2 << 32));
        let last = SEED_LIMIT - 1;
        assert!(spec.attempts(last).is_sorted() && spec.attempts(last).all(|attempt| attempt < u64::MAX));
    }

    #[test]
    fn a_wrong_setting_is_named() {
        assert_eq!(spec().validate(), Ok(()));
        for (wrong, field) in [
            (EvaluateSpec { episodes: 0, ..spec() }, "episodes"),
            (EvaluateSpec { episodes: 500_001, ..spec() }, "episodes"),
            (EvaluateSpec { max_steps: 0, ..spec() }, "max_steps"),
            (EvaluateSpec { seeds: vec![3, 3], ..spec() }, "seeds"),
            (EvaluateSpec { seeds: vec![u64::MAX], ..spec() }, "seeds"),
        ] {
            assert_eq!(wrong.validate().unwrap_err().0, field);
        }
    }

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
