//! Features of an episode's segments: what similarities compare. Every frame is encoded once.
//! Independent of their comparison.

pub(super) mod kept;
mod learned;
pub(super) mod raw;
mod rough;
mod states;

use crate::batch::{Batch, Segment, Segments, Windows, int, rows, values};
use crate::error::LearnError;
use crate::history::Stacked;
use crate::model::{Network, View};
use crate::normalize::FeatureScale;
use crate::score::comparison::{Comparison, Source};
use crate::shape::TaskShape;
use crate::trajectory::Trajectory;
use gleaner_search::PointShape;
use tch::{Device, Tensor};

pub use kept::{FeatureStore, Forgetful};
pub(super) use rough::Rough;
pub(super) use states::states;

/// Number of steps encoded, and of windows passed, at a time. It bounds memory; being fixed, it makes an episode's
/// features independent of the other episodes.
const CHUNK: usize = 128;

/// The number of chunks of an episode of this many steps.
pub(super) fn chunks(steps: usize) -> usize {
    steps.div_ceil(CHUNK)
}

/// The steps of the chunk of this number.
pub(super) fn chunk(
    shape: &TaskShape,
    trajectory: &Trajectory,
    number: usize,
    device: Device,
) -> Result<Batch, LearnError> {
    let every = Segments::every(&[trajectory]).all();
    let segments = every.chunks(CHUNK).nth(number).unwrap_or_default();
    Batch::collect(shape, &[trajectory], segments, 1, device)
}

/// An episode whose features are computed: its segments, and its chunks in order, each of which is called for once.
pub(super) struct Episode<'a> {
    every: Vec<Segment>,
    next: &'a mut dyn FnMut() -> Result<Batch, LearnError>,
}

impl Episode<'_> {
    /// What `act` makes of each chunk of steps.
    fn each<T>(&mut self, act: impl Fn(&Batch) -> T) -> Result<Vec<T>, LearnError> {
        (0..chunks(self.every.len())).map(|_| Ok(act(&(self.next)()?))).collect()
    }
}

/// Features of T segments: one point each, with the parts o, m and a.
pub(super) type Features = gleaner_search::Points;

/// The error for an episode whose standardised values are not finite, or too large to be compared.
pub(super) fn too_far(episode: &str) -> LearnError {
    let message = "is too far from the encoder's data to be standardised; correct it or leave it out";
    LearnError::invalid(format!("episode {episode}"), message)
}

/// Appends rows, `[N, width]` per modality, in sequence.
fn extend(features: &mut Features, parts: &[Tensor; 3]) {
    features.extend(parts.each_ref().map(values));
}

/// The network and settings of feature extraction.
#[derive(Clone, Copy)]
pub(super) struct Encoder<'a> {
    pub(super) network: &'a Network,
    /// The scale of the features.
    pub(super) scale: Option<&'a FeatureScale>,
    pub(super) view: View<'static>,
}

/// The windows of an episode's `segments`, and the steps that they are made of, `[N]`.
fn lay_out(network: &Network, segments: &[Segment]) -> (Windows, Tensor) {
    let (windows, needed) = Windows::lay_out(segments, network.spec.window(), network.device());
    let needed: Vec<i64> = needed.iter().map(|(_, t)| int(*t)).collect();
    (windows, Tensor::from_slice(&needed).to_device(network.device()))
}

/// `[W, keep, 1]` of `bool`: which of the last `keep` places of each window are before the episode.
fn padding(windows: &Windows, keep: usize) -> Tensor {
    windows.valid.logical_not().narrow(1, int(windows.length - keep), int(keep)).unsqueeze(-1)
}

/// Number of values in a step's embedding of its frames in a history.
pub(super) fn embedding_width(network: &Network, source: Source) -> usize {
    match source {
        Source::Features(_) => network.width(),
        Source::Observations => raw::step_widths(network)[0],
    }
}

/// Frames, each with the layout of one step of [`StepSource`](crate::StepSource), to one embedding each
/// `[N, embedding_width]`, for histories.
pub(super) fn embed_frames(network: &Network, source: Source, frames: &[&[u8]]) -> Tensor {
    match source {
        Source::Features(_) => network.embed_frames(frames),
        Source::Observations => raw::embed_frames(network, frames),
    }
}

/// The compared features of the newest segment of each history in `stacked`, as [`episode_features`] returns those of
/// an episode. The embeddings are of [`embed_frames`].
pub(super) fn newest_features(encoder: Encoder<'_>, stacked: &Stacked, comparison: &Comparison) -> Features {
    let network = encoder.network;
    let keep = keep(network, comparison);
    match comparison.source {
        Source::Features(_) => {
            let mut features = Features::empty(shape(network, comparison));
            let steps = network.steps(&stacked.embedded, &stacked.proprioception, &stacked.action);
            extend(&mut features, &learned::pass(encoder, &steps, &stacked.windows, keep));
            features
        }
        Source::Observations => raw::newest(network, stacked, keep),
    }
}

/// Number of steps of a segment that are compared.
fn keep(network: &Network, comparison: &Comparison) -> usize {
    if comparison.similarity.whole_segment() { network.spec.window() } else { 1 }
}

/// The shape of a segment's features. Those of a step depend on its segment when a network made them, and are otherwise
/// shared by all segments with that step.
pub(super) fn shape(network: &Network, comparison: &Comparison) -> PointShape {
    let keep = keep(network, comparison);
    match comparison.source {
        Source::Features(_) => [keep * network.width(); 3].into(),
        Source::Observations => raw::shape(network, keep),
    }
}

/// z^o, z^m and z^a of the last step of every segment of `trajectory`, as the output of the transformer, each `[T, d]`.
pub(crate) fn last_steps(
    network: &Network,
    view: View<'static>,
    trajectory: &Trajectory,
) -> Result<[Tensor; 3], LearnError> {
    let encoder = Encoder { network, scale: None, view };
    let features = read(network, trajectory, |episode| learned::features(encoder, episode, 1))?;
    Ok([0, 1, 2].map(|modality| rows(features.values(modality), features.widths()[modality], network.device())))
}

/// The compared features of every segment of `trajectory`.
pub(super) fn episode_features(
    encoder: Encoder<'_>,
    trajectory: &Trajectory,
    comparison: &Comparison,
) -> Result<Features, LearnError> {
    read(encoder.network, trajectory, |episode| features_of(encoder, episode, comparison))
}

/// As [`episode_features`], of chunks that are read by `next`.
pub(super) fn features_from(
    encoder: Encoder<'_>,
    trajectory: &Trajectory,
    comparison: &Comparison,
    next: &mut dyn FnMut() -> Result<Batch, LearnError>,
) -> Result<Features, LearnError> {
    features_of(encoder, Episode { every: Segments::every(&[trajectory]).all(), next }, comparison)
}

fn features_of(encoder: Encoder<'_>, episode: Episode<'_>, comparison: &Comparison) -> Result<Features, LearnError> {
    let keep = keep(encoder.network, comparison);
    match comparison.source {
        Source::Features(_) => learned::features(encoder, episode, keep),
        Source::Observations => raw::features(encoder.network, episode, keep),
    }
}

/// What `make` makes of an episode whose chunks are read when they are due.
fn read<T>(
    network: &Network,
    trajectory: &Trajectory,
    make: impl FnOnce(Episode<'_>) -> Result<T, LearnError>,
) -> Result<T, LearnError> {
    let mut numbers = 0..;
    let mut next = || chunk(&network.shape, trajectory, numbers.next().unwrap_or_default(), network.device());
    make(Episode { every: Segments::every(&[trajectory]).all(), next: &mut next })
}

#[cfg(test)]
mod tests;
