//! The result of a comparison: one structure, of which the text, the JSON and the CSV are made. A value that could not
//! be computed is absent.

use std::collections::BTreeMap;

use gleaner_core::Values;
use serde::Serialize;

use super::super::rate::Rate;
use super::super::report::PooledAuroc;

/// A comparison of scorers.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Comparison {
    /// The command that makes it.
    pub(super) command: String,
    pub(super) task: String,
    pub(super) snapshot: String,
    /// The encoder of each seed, if it exists.
    pub(super) encoders: Vec<Option<String>>,
    pub(super) experts: usize,
    /// Imperfect episodes.
    pub(super) imperfect: usize,
    /// Their number of each outcome.
    pub(super) outcomes: BTreeMap<String, usize>,
    /// Their segments; absent if no scorer has a run.
    pub(super) segments: Option<usize>,
    /// Imperfect episodes with a mark.
    pub(super) marked: usize,
    /// The best part, by q and then w.
    pub(super) top_fraction: f64,
    /// The strata of equal length.
    pub(super) length_bins: Vec<LengthBin>,
    /// The policy that each best part trains.
    pub(super) policy: Option<String>,
    /// The simulator's task that evaluates the policies.
    pub(super) simulation: Option<String>,
    pub(super) scorers: Vec<ScorerReport>,
    /// The length of an episode as if it were a score, where shorter is better.
    pub(super) length_alone: Option<Separated>,
    /// The number of a step as if it were a score, where earlier is better.
    pub(super) step_alone: Option<Separated>,
    /// Of each pair of scorers.
    pub(super) agreement: Vec<Agreement>,
}

/// Imperfect episodes of about equal length.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub(super) struct LengthBin {
    /// The shortest and the longest, in steps.
    pub(super) from: u64,
    pub(super) to: u64,
    pub(super) episodes: usize,
}

/// One scorer.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct ScorerReport {
    pub(super) label: String,
    /// Of its score jobs, without the seed.
    pub(super) settings: Values,
    pub(super) seeds: Vec<ScorerSeed>,
    /// Different score runs among the seeds.
    pub(super) runs: usize,
    pub(super) separated: Separated,
    /// The correlation of an episode's mean q with its length.
    pub(super) length: Vec<LengthCorrelation>,
    /// Mean correlation of q between two of its runs; of two runs or more.
    pub(super) stability: Option<f64>,
    pub(super) success: Success,
}

/// One seed of a scorer.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct ScorerSeed {
    pub(super) seed: u64,
    /// The score run and the policy, once they exist.
    pub(super) run: Option<String>,
    pub(super) policy: Option<String>,
    pub(super) success: Option<Rate>,
    /// Why it is not complete.
    pub(super) problem: Option<String>,
}

/// How well scores separate good from bad.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(super) struct Separated {
    /// Marked segments: over all, failures only, then by cohort.
    pub(super) marked: Vec<Auroc>,
    /// Imperfect episodes by their outcome: mean q of successes against failures.
    pub(super) outcome: Option<Auroc>,
}

/// An area under the ROC curve, the mean over a scorer's runs.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Auroc {
    /// A mean, with the lowest and the highest bound of the runs' 95 % intervals.
    #[serde(flatten)]
    pub(super) pooled: PooledAuroc,
    /// Over pairs of episodes of equal length alone.
    pub(super) equal_length: Option<f64>,
    /// The number of those pairs.
    pub(super) pairs: u64,
    /// Over pairs of segments that end at the same step alone. Episodes have none.
    pub(super) equal_step: Option<f64>,
    /// The number of those pairs.
    pub(super) step_pairs: u64,
}

/// Spearman's correlation of mean q and length over a group of episodes, the mean over a scorer's runs.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct LengthCorrelation {
    pub(super) group: String,
    pub(super) episodes: usize,
    pub(super) spearman: Option<f64>,
}

/// How alike two scorers are: means over their runs of the same seed.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Agreement {
    pub(super) one: String,
    pub(super) other: String,
    /// Of q, over all imperfect segments.
    pub(super) spearman: Option<f64>,
    /// Of the best parts: the segments in both, out of those in either.
    pub(super) overlap: Option<f64>,
}

/// The success of a scorer's policies.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub(super) struct Success {
    /// Over all attempts of all seeds, with Wilson's interval.
    pub(super) pooled: Option<Rate>,
    /// The mean of the seeds' rates, and Student's 95 % interval of it.
    pub(super) mean_of_seeds: Option<f64>,
    pub(super) interval_of_seeds: Option<(f64, f64)>,
    /// Shares of the best part that is good, and of the good segments in the best part, by the marks.
    pub(super) precision: Option<f64>,
    pub(super) recall: Option<f64>,
}

/// The columns of what separates without looking at a segment.
pub(super) const LENGTH: &str = "length alone";
pub(super) const STEP: &str = "step alone";

impl Comparison {
    /// What separates without looking at a segment, with its column.
    pub(super) fn alone(&self) -> impl Iterator<Item = (&'static str, &Separated)> {
        let columns = [(LENGTH, &self.length_alone), (STEP, &self.step_alone)];
        columns.into_iter().filter_map(|(label, separated)| Some((label, separated.as_ref()?)))
    }

    /// The seeds that are not complete, with their scorers.
    pub(super) fn problems(&self) -> Vec<(&str, &ScorerSeed)> {
        let seeds =
            self.scorers.iter().flat_map(|scorer| scorer.seeds.iter().map(move |seed| (scorer.label.as_str(), seed)));
        seeds.filter(|(_, seed)| seed.problem.is_some()).collect()
    }
}
