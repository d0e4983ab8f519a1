//! Success rates of trainings, and the seed of their resampling.
//!
//! Must not depend on a server or on reports.

use gleaner_core::statistics::{Attempts, wilson};
use serde::{Deserialize, Serialize};

/// The seed of the bootstrap intervals, so that a report repeats to the digit.
pub(crate) const RESAMPLING_SEED: u64 = 0;

/// Successes among a number of episodes, with the 95 % Wilson interval of the rate.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Rate {
    pub(crate) episodes: u32,
    pub(crate) successes: u32,
    pub(crate) rate: f64,
    pub(crate) low: f64,
    pub(crate) high: f64,
}

impl Rate {
    pub(crate) fn new(successes: u32, episodes: u32) -> Self {
        let (low, high) = wilson(successes, episodes);
        Self { episodes, successes, rate: f64::from(successes) / f64::from(episodes.max(1)), low, high }
    }

    pub(crate) fn attempts(self) -> Attempts {
        Attempts { successes: self.successes, total: self.episodes }
    }
}
