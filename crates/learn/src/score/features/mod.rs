//! Features of an episode's segments: what similarities compare. Every frame is encoded once.
//! Independent of their comparison.

pub(super) mod kept;
mod learned;
pub(super) mod raw;

use crate::batch::{rows, values};
use crate::history::Stacked;
use crate::model::{Network, View};
use crate::normalize::FeatureScale;
use crate::score::comparison::{Comparison, Source};
use crate::trajectory::Trajectory;
use tch::Tensor;

pub use kept::{FeatureStore, Forgetful, features_kind};

/// Steps encoded, and windows passed, at a time: bounds memory, and being fixed it gives an
/// episode the same features whatever it is scored with.
const CHUNK: usize = 128;

/// Features of T segments: a point each, whose parts are o, m and a.
pub(super) type Features = gleaner_search::Points;

/// Appends rows, `[N, width]` per modality.
fn extend(features: &mut Features, parts: &[Tensor; 3]) {
    features.extend(parts.each_ref().map(values));
}

/// How features are taken.
#[derive(Clone, Copy)]
pub(super) struct Encoder<'a> {
    pub(super) network: &'a Network,
    /// What they are measured in.
    pub(super) scale: Option<&'a FeatureScale>,
    pub(super) view: View<'static>,
}

/// The features of the newest segment of each history in `stacked`, that are compared, as [`episode_features`] gives
/// those of an episode. Of the encoder only: raw observations are not kept in histories.
pub(super) fn newest_features(encoder: Encoder<'_>, stacked: &Stacked, comparison: &Comparison) -> Features {
    let network = encoder.network;
    let keep = keep(network, comparison);
    let steps = network.steps(&stacked.embedded, &stacked.proprioception, &stacked.action);
    let mut features = Features::empty(widths(network, comparison));
    extend(&mut features, &learned::pass(encoder, &steps, &stacked.windows, keep));
    features
}

/// How many steps of a segment are compared.
fn keep(network: &Network, comparison: &Comparison) -> usize {
    if comparison.similarity.whole_segment() { network.spec.window() } else { 1 }
}

/// How many values the features of a segment have that the encoder gives, per modality.
pub(super) fn widths(network: &Network, comparison: &Comparison) -> [usize; 3] {
    [keep(network, comparison) * network.width(); 3]
}

/// z^o, z^m and z^a of the last step of every segment of `trajectory`, as the transformer gives them, each `[T, d]`.
pub(crate) fn last_steps(network: &Network, view: View<'static>, trajectory: &Trajectory) -> [Tensor; 3] {
    let features = learned::features(Encoder { network, scale: None, view }, trajectory, 1);
    [0, 1, 2].map(|modality| rows(features.values(modality), features.widths()[modality], network.device()))
}

/// The features of every segment of `trajectory` that are compared.
pub(super) fn episode_features(encoder: Encoder<'_>, trajectory: &Trajectory, comparison: &Comparison) -> Features {
    match comparison.source {
        Source::Features(_) => learned::features(encoder, trajectory, keep(encoder.network, comparison)),
        Source::Observations => raw::features(encoder.network, trajectory, comparison.similarity.whole_segment()),
    }
}

#[cfg(test)]
mod tests;
