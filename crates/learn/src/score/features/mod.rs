//! Features of an episode's segments: what similarities compare. Every frame is encoded once.
//! Knows nothing of how features are compared.

mod kept;
mod learned;
pub(super) mod raw;

use crate::batch::{rows, values};
use crate::error::LearnError;
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

/// Features of T segments, row-major in single precision; o, m and a may differ in width.
#[derive(Debug, Clone, PartialEq)]
pub struct Features {
    values: [Vec<f32>; 3],
    widths: [usize; 3],
}

impl Features {
    /// For o, m, a: T rows of `widths` values each.
    ///
    /// # Errors
    /// [`LearnError::Invalid`] if a width is zero, the modalities do not have the same number of
    /// rows, or a value is not finite or so large that its square could overflow.
    pub fn new(values: [Vec<f32>; 3], widths: [usize; 3]) -> Result<Self, LearnError> {
        if widths.contains(&0) {
            return Err(LearnError::invalid("widths", "has a zero; every modality needs at least one value"));
        }
        let features = Self { values, widths };
        let count = features.count();
        if (0..3).any(|i| features.values[i].len() != count * widths[i]) {
            return Err(LearnError::invalid("values", "do not have the same number of rows in every modality"));
        }
        if !features.sound() {
            return Err(LearnError::invalid("values", "must be finite and below 1e15"));
        }
        Ok(features)
    }

    /// No segment yet.
    pub(crate) fn empty(widths: [usize; 3]) -> Self {
        Self { values: Default::default(), widths }
    }

    /// Appends rows, `[N, width]` per modality.
    fn extend(&mut self, parts: &[Tensor; 3]) {
        for (all, part) in self.values.iter_mut().zip(parts) {
            all.extend(values(part));
        }
    }

    /// Appends the rows of `other`, which has the same widths.
    pub(crate) fn append(&mut self, other: &Self) {
        for (all, part) in self.values.iter_mut().zip(&other.values) {
            all.extend_from_slice(part);
        }
    }

    /// Number of segments T.
    pub fn count(&self) -> usize {
        self.values[0].len() / self.widths[0].max(1)
    }

    /// Values a row, per modality.
    pub(crate) fn widths(&self) -> [usize; 3] {
        self.widths
    }

    /// All values of `modality`, row-major.
    pub(crate) fn values(&self, modality: usize) -> &[f32] {
        &self.values[modality]
    }

    /// Feature `modality` of segment `at`.
    pub(crate) fn row(&self, modality: usize, at: usize) -> &[f32] {
        let width = self.widths[modality];
        &self.values[modality][at * width..(at + 1) * width]
    }

    /// Whether every value is a number whose square does not overflow when many are summed.
    pub(crate) fn sound(&self) -> bool {
        self.values.iter().flatten().all(|value| value.abs() < 1e15)
    }
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
    features.extend(&learned::pass(encoder, &steps, &stacked.windows, keep));
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
