//! The settings of a score run.

use super::chosen::{Choice, Chosen, choice};
use super::groups::Device;
use super::{stored, stored_as_values};
use crate::kinds::Family;
use crate::schema::{Problem, Setting, Values};
use crate::settings::{Group as _, Words as _};

crate::words! {
    /// Mapping of similarities to quality scores.
    pub enum NormaliserKind {
        /// Linear: the worst and the best of the run's imperfect segments become 0 and 1.
        MinMax = "minmax",
        /// Rank: the share of the run's imperfect segments that are worse.
        Quantile = "quantile",
        /// Rank among experts: the share of expert segments that are at most as good, compared with the other experts. The
        /// median expert segment has 0.5, whatever the task and the failures; needs two experts.
        Calibrated = "calibrated",
    }
}

impl NormaliserKind {
    /// The default threshold β on q: 0.9 as in the paper; 0.8, the best fifth; 0.5, better than the median expert segment.
    #[must_use]
    pub fn default_beta(self) -> f64 {
        match self {
            Self::MinMax => 0.9,
            Self::Quantile => 0.8,
            Self::Calibrated => 0.5,
        }
    }
}

/// Settings of a score job.
#[derive(Debug, Clone, PartialEq)]
pub struct ScoreSpec {
    /// The scorer.
    pub scorer: Chosen,
    /// The mapping of similarities to scores.
    pub normaliser: NormaliserKind,
    /// The device of the job.
    pub device: Device,
    /// Intra-op threads, set by the worker; `None` keeps the setting of the process.
    pub threads: Option<u32>,
}

crate::settings! {
    /// The settings of every scorer.
    struct Common {
        /// Mapping of similarities to qualities in [0, 1]. It is stored with the run, and runs that extend it keep it. The
        /// default threshold β is that of the normaliser: 0.9 of minmax, 0.8 of quantile, 0.5 of calibrated.
        normaliser: NormaliserKind = NormaliserKind::Calibrated, NormaliserKind::shape();
        /// Device of the computation.
        device: Device = Device::Cpu, Device::shape();
    }
}

impl Default for ScoreSpec {
    fn default() -> Self {
        let Common { normaliser, device } = Common::default();
        Self { scorer: Chosen::first(Family::Scorer), normaliser, device, threads: None }
    }
}

impl ScoreSpec {
    /// Every setting that all scorers have.
    #[must_use]
    pub fn schema() -> Vec<Setting> {
        [vec![choice(Family::Scorer)], Common::schema()].concat()
    }

    /// Reads the settings; one that is left out takes its default.
    ///
    /// # Errors
    /// An unknown setting, one that the chosen scorer does not use, or a value that is not allowed.
    pub fn from_values(values: &Values) -> Result<Self, Problem> {
        let scorer = Choice::read(Family::Scorer, values)?;
        let values = Choice::complete(&[&scorer], &Self::schema(), values)?;
        let Common { normaliser, device } = Common::read(&values)?;
        Ok(Self { scorer: scorer.chosen(&values), normaliser, device, threads: None })
    }

    /// Whether each score depends on all episodes of its run, so that none can be added later.
    #[must_use]
    pub fn needs_all_episodes(&self) -> bool {
        Family::Scorer.find(&self.scorer.name).is_some_and(|kind| kind.needs.all_episodes)
    }

    /// Whether the scorer reads what an encoder has learned.
    #[must_use]
    pub fn needs_encoder(&self) -> bool {
        Family::Scorer.find(&self.scorer.name).is_some_and(|kind| kind.needs.encoder)
    }

    /// Every setting with its value.
    #[must_use]
    pub fn values(&self) -> Values {
        let mut values = Values::new();
        self.scorer.write(Family::Scorer, &mut values);
        Common { normaliser: self.normaliser, device: self.device }.write(&mut values);
        values
    }
}

stored_as_values!(ScoreSpec, stored::score);
