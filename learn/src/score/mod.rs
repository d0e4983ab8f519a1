//! Step two of SSDF: how good each imperfect segment is, by its similarity to the nearest expert
//! segment.
//!
//! w(τ_imp) = max over τ_exp ∈ D_e of sim(τ_imp, τ_exp), q(τ_imp) = norm(w(τ_imp)) ∈ [0, 1].

mod features;
mod nearest;
mod normaliser;
mod similarity;

pub use normaliser::Normaliser;

use std::collections::HashSet;
use std::ops::Range;
use std::time::Instant;

use tch::no_grad_guard;

use crate::checkpoint::{self, CheckpointKind};
use crate::device;
use crate::error::{LearnError, guard};
use crate::model::Network;
use crate::spec::{NormaliserKind, ScoreSpec, Similarity};
use crate::train::Monitor;
use crate::trajectory::Trajectory;
use features::{Features, episode_features};
use nearest::{Match, Reference, Tiles};
use similarity::LastL2;

/// The scores of one episode's segments; place t is the segment that ends at step t.
#[derive(Debug, Clone, PartialEq)]
pub struct EpisodeScores {
    /// The episode's id.
    pub id: String,
    /// Similarity w to the nearest expert segment, at most 0.
    pub w: Vec<f64>,
    /// Quality q in 0 … 1.
    pub q: Vec<f32>,
    /// The nearest expert segment's episode, an index into the experts given.
    pub match_episode: Vec<u32>,
    /// The step the nearest expert segment ends at.
    pub match_step: Vec<u32>,
    /// The distances of o, m and a to it, before any modality scale.
    pub distances: Vec<[f32; 3]>,
}

/// What a score run found.
#[derive(Debug, Clone, PartialEq)]
pub struct Scores {
    /// The imperfect episodes, in the order given.
    pub imperfect: Vec<EpisodeScores>,
    /// The experts, each against the other experts: what w and q look like for good data. Empty
    /// if there is only one expert.
    pub experts: Vec<EpisodeScores>,
    /// Similarity that becomes quality 0: the smallest w of the imperfect segments.
    pub lo: f64,
    /// Similarity that becomes quality 1: the largest w of the imperfect segments.
    pub hi: f64,
}

/// Scores every segment of the `imperfect` episodes (D_i) against every segment of the `experts`
/// (D_e) under a pretrained `encoder`.
///
/// The nearest expert segment is exact; ties go to the first expert, then the first step. An
/// episode never matches itself: an expert of the same id is left out. Progress counts segments;
/// nothing is checkpointed. Metric: `segments_per_second`.
///
/// # Errors
/// [`LearnError::Invalid`] for bad input, [`LearnError::Checkpoint`] or [`LearnError::Version`] for
/// an encoder that cannot be used, [`LearnError::Cancelled`], and what the tensor library may give.
pub fn score(
    encoder: &[u8],
    experts: &[Trajectory],
    imperfect: &[Trajectory],
    spec: &ScoreSpec,
    monitor: &mut dyn Monitor,
) -> Result<Scores, LearnError> {
    spec.validate()?;
    for (field, episodes) in [("experts", experts), ("imperfect", imperfect)] {
        if episodes.is_empty() {
            return Err(LearnError::invalid(field, "has no episode to score with"));
        }
    }
    let mut ids = HashSet::new();
    if let Some(twice) = experts.iter().find(|expert| !ids.insert(&expert.id)) {
        return Err(LearnError::invalid("experts", format!("has episode {} twice; name it once", twice.id)));
    }
    guard(|| {
        let device = device::open(spec.device, spec.threads)?;
        let (info, named) = checkpoint::read(encoder, CheckpointKind::Encoder)?;
        for trajectory in experts.iter().chain(imperfect) {
            trajectory.validate(&info.shape)?;
        }
        let network = Network::from_named(&info.shape, info.model, &named, device)?;
        let _no_grad = no_grad_guard();
        Run::new(&network, experts, imperfect, spec, monitor).scores()
    })
}

/// One score run under way.
struct Run<'a> {
    network: &'a Network,
    experts: &'a [Trajectory],
    imperfect: &'a [Trajectory],
    spec: &'a ScoreSpec,
    monitor: &'a mut dyn Monitor,
    done: u64,
    total: u64,
    begin: Instant,
}

impl<'a> Run<'a> {
    fn new(
        network: &'a Network,
        experts: &'a [Trajectory],
        imperfect: &'a [Trajectory],
        spec: &'a ScoreSpec,
        monitor: &'a mut dyn Monitor,
    ) -> Self {
        let count = |episodes: &[Trajectory]| -> u64 {
            let steps = episodes.iter().map(|t| t.steps(&network.shape));
            steps.map(|steps| steps as u64).sum()
        };
        Self {
            total: 2 * count(experts) + count(imperfect),
            network,
            experts,
            imperfect,
            spec,
            monitor,
            done: 0,
            begin: Instant::now(),
        }
    }

    fn scores(mut self) -> Result<Scores, LearnError> {
        let mut expert_features = Vec::with_capacity(self.experts.len());
        for trajectory in self.experts {
            expert_features.push(self.features(trajectory)?);
        }
        let Similarity::LastL2 = self.spec.similarity;
        let similarity = LastL2 { scale: self.spec.scale() };
        let mut reference = Reference::new(&expert_features, similarity, Tiles::default());
        let mut imperfect = Vec::with_capacity(self.imperfect.len());
        for trajectory in self.imperfect {
            let features = self.features(trajectory)?;
            let without = self.same_id(&trajectory.id);
            let matches = reference.nearest(&features, &without).ok_or_else(|| {
                LearnError::invalid(
                    format!("episode {}", trajectory.id),
                    "is also the only expert, and an episode never matches itself; \
                     leave it out or add experts",
                )
            })?;
            imperfect.push(describe(&trajectory.id, &reference, &matches));
        }
        let mut experts = Vec::with_capacity(self.experts.len());
        for (trajectory, features) in self.experts.iter().zip(&expert_features) {
            let without = self.same_id(&trajectory.id);
            if let Some(matches) = reference.nearest(features, &without) {
                experts.push(describe(&trajectory.id, &reference, &matches));
            }
            self.advance(features.count())?;
        }
        let NormaliserKind::MinMax = self.spec.normaliser;
        let normaliser = Normaliser::min_max(imperfect.iter().flat_map(|e| e.w.iter().copied()));
        for episode in imperfect.iter_mut().chain(&mut experts) {
            episode.q = episode.w.iter().map(|w| normaliser.q(*w)).collect();
        }
        Ok(Scores { imperfect, experts, lo: normaliser.lo, hi: normaliser.hi })
    }

    fn features(&mut self, trajectory: &Trajectory) -> Result<Features, LearnError> {
        let features = episode_features(self.network, trajectory);
        if !features.sound() {
            return Err(LearnError::Checkpoint(format!(
                "gives features of episode {} that are not finite; train the encoder again",
                trajectory.id
            )));
        }
        self.advance(features.count())?;
        Ok(features)
    }

    /// The experts that are the episode `id` itself.
    fn same_id(&self, id: &str) -> Range<usize> {
        match self.experts.iter().position(|expert| expert.id == id) {
            Some(at) => at..at + 1,
            None => 0..0,
        }
    }

    fn advance(&mut self, segments: usize) -> Result<(), LearnError> {
        if self.monitor.cancelled() {
            return Err(LearnError::Cancelled);
        }
        self.done += segments as u64;
        #[expect(clippy::cast_precision_loss, reason = "a rate for people to read")]
        let rate = self.done as f64 / self.begin.elapsed().as_secs_f64().max(1e-9);
        self.monitor.progress(self.done, self.total, &[("segments_per_second", rate)]);
        Ok(())
    }
}

fn describe(id: &str, reference: &Reference, matches: &[Match]) -> EpisodeScores {
    let (match_episode, match_step) = matches.iter().map(|m| reference.place(m.expert)).unzip();
    #[expect(clippy::cast_possible_truncation, reason = "kept in single precision")]
    let single = |distances: [f64; 3]| distances.map(|distance| distance as f32);
    EpisodeScores {
        id: id.to_owned(),
        w: matches.iter().map(|m| -m.distance).collect(),
        q: Vec::new(),
        match_episode,
        match_step,
        distances: matches.iter().map(|m| single(m.parts)).collect(),
    }
}

#[cfg(test)]
mod tests;
