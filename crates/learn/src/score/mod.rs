//! Step two of SSDF: the quality of each imperfect segment, by its similarity to the nearest expert segment.
//!
//! w(τ_imp) = max over τ_exp ∈ D_e of sim(τ_imp, τ_exp), q(τ_imp) = norm(w(τ_imp)) ∈ [0, 1]. The paper leaves norm
//! open; [`local`] defines the scale of similarities, and [`measure`] the value that norm is applied to.

mod ahead;
mod alike;
mod base;
mod comparison;
mod feature_key;
mod features;
mod form;
mod indexes;
mod live;
mod local;
mod matched;
mod measure;
mod normaliser;
mod opened;
mod progress;
mod reader;
mod run;
pub(crate) mod scorer;
mod similarity;

pub use comparison::{FeatureScale, Similarity};
pub use feature_key::features_kind;
pub(crate) use features::last_steps;
pub use features::{FeatureStore, Forgetful};
pub use live::{LiveScorer, SegmentScore};
pub use normaliser::Normaliser;

use std::collections::HashSet;

use tch::no_grad_guard;

use crate::error::{LearnError, guard};
use crate::peers::Peers;
use crate::progress::SEGMENTS;
use crate::shards::Shards;
use crate::train::Monitor;
use crate::trajectory::Trajectory;
use base::Known;
use comparison::Comparison;
use features::Encoder;
use gleaner_core::{NormaliserKind, ScoreSpec};
use measure::Measure;
use opened::Opened;
use run::{Found, Run, unscaled};
use scorer::Scorer;

/// The scores of one episode's segments, by the episode's name; entry t is the segment that ends at step t. w is the
/// classifier's log p(expert), DemInf's information, the gain of `progress` or the share of `vote` if that is the scorer,
/// and q is in 0 … 1. `match_episode` is an index into the given experts. Distances are before any modality scale.
pub type EpisodeScores = gleaner_core::score::EpisodeScores<String>;

/// The result of a score run.
#[derive(Debug, Clone, PartialEq)]
pub struct Scores {
    /// The imperfect episodes, in the given order.
    pub imperfect: Vec<EpisodeScores>,
    /// The experts, each scored without itself and its copies where the scorer uses experts, as a reference for good data.
    /// A single recording has no other to be compared with; where the scorer compares segments, the list is then empty.
    pub experts: Vec<EpisodeScores>,
    /// The conversion from w to q.
    pub normaliser: Normaliser,
}

/// The results of an earlier run that is extended.
#[derive(Debug, Clone, PartialEq)]
pub struct ScoreBase {
    /// The earlier run's normaliser; the new run keeps it.
    pub normaliser: Normaliser,
    /// The ids of the earlier run's experts, to which its `match_episode` refers.
    pub experts: Vec<String>,
    /// The scores of its imperfect episodes and of its experts; q is ignored.
    pub scores: Vec<EpisodeScores>,
}

/// The inputs of a score run.
#[derive(Clone, Copy)]
pub struct ScoreInputs<'a> {
    /// The pretrained encoder's checkpoint.
    pub encoder: &'a [u8],
    /// D_e.
    pub experts: &'a [Trajectory],
    /// D_i.
    pub imperfect: &'a [Trajectory],
    /// Features of these episodes under this encoder and [`features_kind`]; episodes in it are not encoded again.
    pub kept: &'a dyn FeatureStore,
}

/// Scores every segment of the imperfect episodes (D_i) against every segment of the experts (D_e) under a pretrained
/// encoder.
///
/// The nearest expert segment is exact; ties go to the expert whose id sorts first, then to the first step, so the
/// order of the episodes does not matter. An episode never matches itself: an expert of the same id is left out, and so
/// are experts with its features, which are copies of it under other ids.
/// Progress counts segments; there are no checkpoints. Metric: `segments_per_second`.
///
/// # Errors
/// [`LearnError::Invalid`] for bad input, [`LearnError::Checkpoint`] or [`LearnError::Version`] for an encoder that
/// cannot be used, [`LearnError::Cancelled`], and errors of the tensor library.
pub fn score(inputs: ScoreInputs<'_>, spec: &ScoreSpec, monitor: &mut dyn Monitor) -> Result<Scores, LearnError> {
    alone(score_with(inputs, None, spec, (&mut Peers::alone(), monitor)))
}

/// Extends an earlier run of the same encoder and settings with more experts, more imperfect
/// episodes, or both. Episodes the earlier run scored are compared only with the experts it did not
/// have, and not even encoded if there are none. The result is bit for bit what [`score`] gives
/// for the same episodes under the earlier run's normaliser. The local scale is measured on the experts
/// there are, so with new experts q may change where w does not.
///
/// # Errors
/// As [`score`]; also [`LearnError::Invalid`] if an expert of the earlier run is missing, if the scores do not fit the
/// episodes, or for a scorer whose every score depends on all episodes.
pub fn extend_scores(
    inputs: ScoreInputs<'_>,
    base: &ScoreBase,
    spec: &ScoreSpec,
    monitor: &mut dyn Monitor,
) -> Result<Scores, LearnError> {
    alone(score_with(inputs, Some(base), spec, (&mut Peers::alone(), monitor)))
}

/// The result of a process that is alone, and so leads.
fn alone(scores: Result<Option<Scores>, LearnError>) -> Result<Scores, LearnError> {
    scores?.ok_or(LearnError::Exchange)
}

/// As [`score`], or [`extend_scores`] with a `base`, as one of the ranks that each score a part of the episodes: every
/// rank calls this with the same input. Rank 0 returns the scores, the others `None`. They are bit for bit those of
/// one process, and so are the kept features. Progress and its metric are of all ranks.
///
/// # Errors
/// As [`score`] and [`extend_scores`]; also [`LearnError::Invalid`] for several ranks with a scorer whose every score depends
/// on all episodes, and [`LearnError::Group`] when another rank is lost.
pub fn score_with(
    inputs: ScoreInputs<'_>,
    base: Option<&ScoreBase>,
    spec: &ScoreSpec,
    (peers, monitor): (&mut Peers, &mut dyn Monitor),
) -> Result<Option<Scores>, LearnError> {
    let scorer = scorer::open(&spec.scorer)?;
    let of_all = |consequence: &str| {
        let message = format!("is {}, whose every score depends on all episodes; {consequence}", spec.scorer.name);
        LearnError::invalid("scorer", message)
    };
    match (scorer.comparison(), base) {
        (None, Some(_)) => return Err(of_all("score without extends")),
        (None, None) if peers.several() => return Err(of_all("score it in one process")),
        (Some(comparison), Some(base)) if comparison.scaled_by_experts() && base.experts.len() == 1 => {
            return Err(unscaled("is one alone"));
        }
        (Some(_) | None, Some(_) | None) => {}
    }
    Call { inputs, spec, scorer }.run(base, peers, monitor)
}

/// Arguments that both ways to score share.
struct Call<'a> {
    inputs: ScoreInputs<'a>,
    spec: &'a ScoreSpec,
    scorer: Scorer,
}

impl Call<'_> {
    fn run(
        &self,
        base: Option<&ScoreBase>,
        peers: &mut Peers,
        monitor: &mut dyn Monitor,
    ) -> Result<Option<Scores>, LearnError> {
        self.validate(base)?;
        guard(|| {
            let opened = Opened::read(self.inputs.encoder, self.spec, self.scorer.feature_scale())?;
            let network = &opened.network;
            for trajectory in self.inputs.experts.iter().chain(self.inputs.imperfect) {
                trajectory.validate(&network.shape)?;
            }
            let found = match &self.scorer {
                Scorer::Nearest(comparison) => self.by_nearest(opened.encoder(), comparison, base, (peers, monitor))?,
                Scorer::Trained(trained) => {
                    let episodes = (self.inputs.experts, self.inputs.imperfect);
                    let (imperfect, experts) = (trained.scores)(opened.encoder(), episodes, monitor)?;
                    Some(Found { imperfect, experts, local: None })
                }
            };
            let Some(Found { mut imperfect, mut experts, local }) = found else { return Ok(None) };
            let ahead = self.scorer.comparison().map(|comparison| comparison.ahead).unwrap_or_default();
            let measure = Measure::new(local, (self.inputs.experts, ahead), &experts);
            let normaliser = match base {
                Some(base) => base.normaliser.clone(),
                None => self.normaliser(&imperfect, &experts, &measure)?,
            };
            for episode in imperfect.iter_mut().chain(&mut experts) {
                episode.q = measure.of(episode).into_iter().map(|value| normaliser.q(value)).collect();
            }
            Ok(Some(Scores { imperfect, experts, normaliser }))
        })
    }

    fn validate(&self, base: Option<&ScoreBase>) -> Result<(), LearnError> {
        for (field, episodes) in [("experts", self.inputs.experts), ("imperfect", self.inputs.imperfect)] {
            if episodes.is_empty() {
                return Err(LearnError::invalid(field, "has no episode to score with"));
            }
            let mut ids = HashSet::new();
            if let Some(twice) = episodes.iter().find(|episode| !ids.insert(&episode.id)) {
                return Err(LearnError::invalid(field, format!("has episode {} twice; name it once", twice.id)));
            }
        }
        let compared = self.scorer.comparison().is_some() && base.is_none();
        if compared && self.spec.normaliser == NormaliserKind::Calibrated && self.inputs.experts.len() < 2 {
            return Err(uncalibrated("has one episode"));
        }
        Ok(())
    }

    /// The normaliser of a run from the start.
    fn normaliser(
        &self,
        imperfect: &[EpisodeScores],
        experts: &[EpisodeScores],
        measure: &Measure,
    ) -> Result<Normaliser, LearnError> {
        let kind = self.spec.normaliser;
        if kind == NormaliserKind::Calibrated && experts.is_empty() {
            return Err(uncalibrated("are copies of one recording"));
        }
        let scale = match kind {
            NormaliserKind::MinMax | NormaliserKind::Quantile => imperfect,
            NormaliserKind::Calibrated => experts,
        };
        Ok(Normaliser::fit(kind, scale.iter().flat_map(|episode| measure.of(episode)).collect()))
    }

    /// The scores by nearest expert segments, without q, in the given orders; `None` at a rank that does not lead.
    /// Experts are numbered in the order of their ids.
    fn by_nearest(
        &self,
        encoder: Encoder<'_>,
        comparison: &Comparison,
        base: Option<&ScoreBase>,
        (peers, monitor): (&mut Peers, &mut dyn Monitor),
    ) -> Result<Option<Found>, LearnError> {
        let _no_grad = no_grad_guard();
        let ScoreInputs { encoder: _, experts, imperfect, kept } = self.inputs;
        let mut sorted: Vec<(u32, &Trajectory)> = (0..).zip(experts).collect();
        sorted.sort_by(|a, b| a.1.id.cmp(&b.1.id));
        let total = 2 * count(experts) + count(imperfect);
        let (places, experts): (Vec<u32>, Vec<&Trajectory>) = sorted.into_iter().unzip();
        let known = match base {
            Some(base) => Known::new(base, &experts, imperfect)?,
            None => Known::default(),
        };
        let mut shards = Shards::new(peers, monitor, total, Some(SEGMENTS));
        let kept = features_kind(self.spec)?.map(|_| kept);
        let (experts, places, known) = (&experts, &places, &known);
        let run = Run { encoder, comparison, experts, places, known, kept };
        let found = run.scores(imperfect, &mut shards)?;
        Ok(found.map(|Found { imperfect, experts, local }| {
            let local = local.map(|all| placed(places, all));
            Found { imperfect, experts: placed(places, experts), local }
        }))
    }
}

/// The error for experts that cannot be compared with each other.
fn uncalibrated(experts: &str) -> LearnError {
    let cause = "but calibrated compares experts with each other; add another expert, or use the normaliser quantile";
    LearnError::invalid("experts", format!("{experts}, {cause}"))
}

/// Number of segments of `episodes`.
pub(crate) fn count<'a>(episodes: impl IntoIterator<Item = &'a Trajectory>) -> u64 {
    episodes.into_iter().map(|episode| episode.steps() as u64).sum()
}

/// Values of experts in the order of their numbers, rearranged to the given order.
fn placed<T>(places: &[u32], of_numbers: Vec<T>) -> Vec<T> {
    let mut placed: Vec<(u32, T)> = places.iter().copied().zip(of_numbers).collect();
    placed.sort_by_key(|(place, _)| *place);
    placed.into_iter().map(|(_, scores)| scores).collect()
}

#[cfg(test)]
mod tests;
