//! A finished score run kept ready: scores what is not stored, a session's newest segment or a whole episode, as the
//! run would have. Of sessions it uses the histories only.

use std::collections::HashSet;
use std::fmt;

use gleaner_search::{Index, Match, Metric};
use tch::no_grad_guard;

use super::alike::Copies;
use super::comparison::Comparison;
use super::features::{Features, embed_frames, embedding_width, episode_features, newest_features};
use super::local::Spread;
use super::matched::{described, sound, w_of};
use super::measure::Measure;
use super::normaliser::Normaliser;
use super::similarity::metric;
use super::{EpisodeScores, Opened, placed, scorer};
use crate::error::{LearnError, guard};
use crate::history::{Embedding, History, Layout};
use crate::shape::TaskShape;
use crate::trajectory::Trajectory;
use gleaner_core::{ScoreSpec, snapshot::Role};

/// The score of one segment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SegmentScore {
    /// Similarity w to the nearest expert segment, at most 0.
    pub w: f64,
    /// Quality q in 0 … 1, by the run's normaliser.
    pub q: f32,
    /// The nearest expert segment's episode, an index into the given experts.
    pub match_episode: u32,
    /// The step at which that segment ends.
    pub match_step: u32,
    /// The distances of o, m and a to it, before any modality scale.
    pub distances: [f32; 3],
}

/// A finished run of [`score`](fn@crate::score), ready for more segments. `Send`, so that it can have a separate
/// thread.
pub struct LiveScorer {
    opened: Opened,
    comparison: Comparison,
    /// Of each recording once.
    index: Index,
    copies: Copies,
    /// For every number in matches, the expert's index in the given order.
    places: Vec<u32>,
    /// Per number, the expert.
    experts: Vec<Expert>,
    measure: Measure,
    normaliser: Normaliser,
}

/// What remains of an expert beside its features.
struct Expert {
    id: String,
    content: blake3::Hash,
}

impl fmt::Debug for LiveScorer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("LiveScorer").field("comparison", &self.comparison).finish_non_exhaustive()
    }
}

impl LiveScorer {
    /// Loads a run: its encoder, its experts, its settings and its frozen normaliser. Encodes the experts.
    ///
    /// # Errors
    /// [`LearnError::Invalid`] for a scorer whose every score depends on all episodes, for a missing expert, or for one that
    /// does not fit; [`LearnError::Checkpoint`] or [`LearnError::Version`] if `encoder` cannot be used.
    pub fn load(
        encoder: &[u8],
        experts: &[Trajectory],
        spec: &ScoreSpec,
        normaliser: Normaliser,
    ) -> Result<Self, LearnError> {
        normaliser.validate("normaliser")?;
        let scorer = scorer::open(&spec.scorer)?;
        let comparison = *scorer.comparison().ok_or_else(|| {
            let message = format!("is {}; only scorers that compare segments can score live", spec.scorer.name);
            LearnError::invalid("scorer", message)
        })?;
        let mut ids = HashSet::new();
        if experts.is_empty() || !experts.iter().all(|expert| ids.insert(&expert.id)) {
            return Err(LearnError::invalid("experts", "must be at least one, each once"));
        }
        guard(|| {
            let _no_grad = no_grad_guard();
            let opened = Opened::read(encoder, spec, comparison.source.feature_scale())?;
            let mut sorted: Vec<(u32, &Trajectory)> = (0..).zip(experts).collect();
            sorted.sort_by(|a, b| a.1.id.cmp(&b.1.id));
            let mut features = Vec::with_capacity(sorted.len());
            for (_, expert) in &sorted {
                expert.validate(&opened.network.shape)?;
                features.push(sound(episode_features(opened.encoder(), expert, &comparison)?, &expert.id)?);
            }
            let metric = metric(comparison.similarity, comparison.scale);
            let copies = Copies::among(&features);
            let index = Index::new(&copies.distinct(&features), metric)?;
            let known = |(_, expert): &(u32, &Trajectory)| {
                Ok::<_, LearnError>(Expert { id: expert.id.clone(), content: expert.content()? })
            };
            let known: Vec<Expert> = sorted.iter().map(known).collect::<Result<_, _>>()?;
            let places: Vec<u32> = sorted.into_iter().map(|(place, _)| place).collect();
            let (mut local, mut alone) = (None, Vec::new());
            if comparison.scaled_by_experts()
                && let Some(matches) = against_others(&features, &copies, &index)?
            {
                if comparison.local_scale {
                    local = Some(placed(&places, local_scale((&features, &copies), metric, &matches)));
                }
                let of =
                    |(expert, matches): (&Expert, Vec<Match>)| described((&expert.id, Role::Expert), &places, &matches);
                alone = placed(&places, known.iter().zip(matches).map(of).collect());
            }
            let measure = Measure::new(local, (experts, comparison.ahead), &alone);
            Ok(Self { opened, comparison, index, copies, places, experts: known, measure, normaliser })
        })
    }

    /// The task's shape.
    pub fn shape(&self) -> &TaskShape {
        &self.opened.network.shape
    }

    /// The segment length l, for a new [`History`].
    pub fn segment_length(&self) -> u32 {
        self.opened.network.spec.segment_length
    }

    /// Encodes frames for this scorer, each with the layout of one step of [`StepSource`](crate::StepSource).
    ///
    /// # Errors
    /// [`LearnError::Invalid`] if a frame's length does not fit the shape.
    pub fn embed(&self, frames: &[&[u8]]) -> Result<Vec<Embedding>, LearnError> {
        self.layout().embed(frames, |frames| embed_frames(&self.opened.network, self.comparison.source, frames))
    }

    /// The score of the newest segment of each history; one pass for all. Its last action must be set, because a
    /// segment is scored by the executed actions. Where q depends on later steps, which are unknown, it is
    /// that of the similarity alone.
    ///
    /// # Errors
    /// [`LearnError::Invalid`] if a history is empty, of another segment length, holds values that do not fit the
    /// shape or are not finite, or its newest action is not set.
    pub fn score(&self, histories: &[&History]) -> Result<Vec<SegmentScore>, LearnError> {
        self.layout().check(histories)?;
        if let Some(at) = histories.iter().position(|history| !history.acted()) {
            return Err(LearnError::invalid(
                format!("histories[{at}]"),
                "has no action at its newest step; set what was executed",
            ));
        }
        if histories.is_empty() {
            return Ok(Vec::new());
        }
        guard(|| {
            let _no_grad = no_grad_guard();
            let stacked = self.layout().stack(histories);
            let features = newest_features(self.opened.encoder(), &stacked, &self.comparison);
            let found = self.matches(&sound(features, "now running")?, None)?;
            Ok(found.iter().map(|found| self.segment(found)).collect())
        })
    }

    /// The scores of every segment of an unstored episode: bit for bit those of the run. An episode with the steps of an
    /// expert gets that expert's id and role, and is compared with the other recordings, as the run compared it.
    ///
    /// # Errors
    /// [`LearnError::Invalid`] if the episode does not fit the shape, or has the steps of the only expert.
    pub fn score_episode(&self, episode: &Trajectory) -> Result<EpisodeScores, LearnError> {
        episode.validate(&self.opened.network.shape)?;
        guard(|| {
            let _no_grad = no_grad_guard();
            let content = episode.content()?;
            let own = (0..).zip(&self.experts).find(|(_, expert)| expert.content == content);
            let features = sound(episode_features(self.opened.encoder(), episode, &self.comparison)?, &episode.id)?;
            let matches = self.matches(&features, own.map(|(number, _)| self.copies.first(number)))?;
            let (id, role) = own.map_or((&episode.id, Role::Imperfect), |(_, expert)| (&expert.id, Role::Expert));
            let mut scores = described((id, role), &self.places, &matches);
            scores.q = self.measure.of(&scores).into_iter().map(|value| self.normaliser.q(value)).collect();
            Ok(scores)
        })
    }

    /// The matches of `features`; `own` is the number of the expert that they are of, which no segment may match.
    fn matches(&self, features: &Features, own: Option<u32>) -> Result<Vec<Match>, LearnError> {
        self.index.nearest(features, own)?.ok_or_else(|| {
            LearnError::invalid(
                "recording",
                "has the steps of the run's only expert, and an episode never matches itself; score with more experts",
            )
        })
    }

    fn segment(&self, found: &Match) -> SegmentScore {
        let (w, expert) = (w_of(found), self.places[found.group as usize]);
        SegmentScore {
            w,
            q: self.normaliser.q(self.measure.now(w, (expert as usize, found.row as usize))),
            match_episode: expert,
            match_step: found.row,
            distances: found.parts,
        }
    }

    fn layout(&self) -> Layout<'_> {
        Layout {
            shape: &self.opened.network.shape,
            window: self.opened.network.spec.window(),
            width: embedding_width(&self.opened.network, self.comparison.source),
            device: self.opened.network.device(),
        }
    }
}

/// The matches of every expert among the other recordings; `None` with a single one.
fn against_others(experts: &[Features], copies: &Copies, index: &Index) -> Result<Option<Vec<Vec<Match>>>, LearnError> {
    (0..).zip(experts).map(|(number, features)| Ok(index.nearest(features, Some(copies.first(number)))?)).collect()
}

/// The local scale around each segment of the experts, by the matches of each among the others.
fn local_scale(experts: (&[Features], &Copies), metric: Metric, matches: &[Vec<Match>]) -> Vec<Vec<f64>> {
    let alone: Vec<Vec<f64>> = matches.iter().map(|matches| matches.iter().map(w_of).collect()).collect();
    let alone: Vec<&[f64]> = alone.iter().map(Vec::as_slice).collect();
    let spread = Spread::new(experts, metric, &alone);
    (0..alone.len()).map(|expert| spread.around(expert)).collect()
}

#[cfg(test)]
mod tests;
