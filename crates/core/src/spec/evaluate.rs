//! The settings of closed-loop trials in the embedded simulator.

use std::ops::Range;

use super::groups::Device;
use crate::schema::{Problem, Setting, Shape, Values, complete, integer_in};
use crate::settings::{Group as _, Words as _};

/// Most attempts that run side by side: enough for an efficient pass, few enough that one seed of an ordinary evaluation has several blocks.
const BLOCK: u32 = 64;
/// Upper bound of seeds, so that no two seeds share an attempt.
const SEED_LIMIT: u64 = u32::MAX as u64;

crate::settings! {
    /// Settings of an evaluation job.
    pub struct EvaluateSpec {
        /// Name of the simulator's task, such as `pick_cube`. Empty: the name of the task itself.
        pub simulation: String = String::new(), Shape::Text;
        /// Attempts for each seed. More attempts narrow the confidence interval and take longer.
        pub episodes: u32 = 200, integer_in(1, 1_000_000);
        /// Seeds of the attempts; no two seeds share an attempt. More seeds narrow the confidence interval and take
        /// longer.
        pub seeds: Vec<u64> = vec![0], Shape::Integers { most: SEED_LIMIT - 1, count: 1000 };
        /// Steps after which an attempt ends as a failure. More steps give slow policies time to finish; failed
        /// attempts then take longer.
        pub max_steps: u32 = 60, integer_in(1, 10_000);
        /// Hide the history from the policy, which then acts on the newest step alone, or without its past actions if it was
        /// trained with `hidden_history` actions. Needs a policy that was trained with `history_dropout` above 0.
        pub hide_history: bool = false, Shape::Flag;
        /// Device that runs the policy.
        pub device: Device = Device::Cpu, Device::shape();
    }
}

impl EvaluateSpec {
    /// Every setting.
    #[must_use]
    pub fn schema() -> Vec<Setting> {
        <Self as crate::Group>::schema()
    }

    /// Reads the settings; one that is left out takes its default.
    ///
    /// # Errors
    /// An unknown setting, a value that is not allowed, or more than a million attempts in all.
    pub fn from_values(values: &Values) -> Result<Self, Problem> {
        let spec = Self::read(&complete(&Self::schema(), values, |_| None)?)?;
        let total = u64::from(spec.episodes) * spec.seeds.len() as u64;
        if total > 1_000_000 {
            return Err(Problem::new("episodes", format!("make {total} attempts in all, must be at most 1000000")));
        }
        if spec.simulation.len() > 255 || spec.simulation.chars().any(char::is_control) {
            return Err(Problem::new("simulation", "must be at most 255 bytes without control characters"));
        }
        Ok(spec)
    }

    /// Every setting with its value.
    #[must_use]
    pub fn values(&self) -> Values {
        let mut values = Values::new();
        self.write(&mut values);
        values
    }

    /// The simulator's seeds of a seed's attempts, from 2³² · (seed + 1) upwards: no two seeds share one, and none is a
    /// seed of a small recorded set.
    #[must_use]
    pub fn attempts(&self, seed: u64) -> Range<u64> {
        let first = seed.saturating_add(1).saturating_mul(1 << 32);
        first..first.saturating_add(u64::from(self.episodes))
    }

    /// The blocks of attempts that run side by side, in order: a seed and some of its attempts. The last bits of a pass
    /// depend on how many share it, so a block has the same results wherever it runs.
    #[must_use]
    pub fn blocks(&self) -> Vec<Block> {
        let count = self.episodes.div_ceil(BLOCK);
        let bound = |block: u32| u64::from(self.episodes) * u64::from(block) / u64::from(count);
        let of_seed = |(seed_index, seed): (usize, &u64)| {
            let first = self.attempts(*seed).start;
            (0..count).map(move |block| Block {
                seed_index,
                attempts: first.saturating_add(bound(block))..first.saturating_add(bound(block + 1)),
            })
        };
        self.seeds.iter().enumerate().flat_map(of_seed).collect()
    }
}

/// Attempts of one seed that run side by side.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Block {
    /// Place of the seed among the seeds of the evaluation.
    pub seed_index: usize,
    /// Seeds of the simulator, one for each attempt.
    pub attempts: Range<u64>,
}
