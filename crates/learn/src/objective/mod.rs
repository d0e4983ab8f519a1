//! The self-supervised objectives of pretraining, one a file, and what they share: the errors of
//! the heads' predictions. Independent of batches and optimisers.
//!
//! log P is Gaussian with fixed variance, so minus log P is the squared error up to constants. The error of an element
//! is the mean over its values of standardised m or a, or of the down-sampled standardised image, so that o, m and a
//! have equal weight for any sizes. A loss is the sum over its elements, as in the paper, for each step of the segments.

pub(crate) mod action_autoregression;
mod kind;
mod list;
mod masked_transition;
mod masking;
mod passes;
mod reconstruction;

pub(crate) use kind::Objective;
pub(crate) use list::{describe, features_view, find};
pub(crate) use passes::Passes;

use tch::Tensor;

use crate::batch::{Batch, int};
use crate::model::{Modality, Network};

/// The target of the heads at each place of each window, standardised.
pub(crate) struct Targets {
    /// `[W, L, O]`.
    image: Tensor,
    /// `[W, L, M]`.
    proprioception: Tensor,
    /// `[W, L, A]`.
    pub(crate) action: Tensor,
}

impl Targets {
    /// The targets of `batch`.
    pub(crate) fn new(network: &Network, batch: &Batch) -> Self {
        let statistics = &network.statistics;
        let spread =
            |steps: &Tensor| steps.index_select(0, &batch.windows.index).unflatten(0, [-1, int(batch.windows.length)]);
        let images: Vec<Tensor> = batch
            .images
            .iter()
            .zip(&statistics.cameras)
            .map(|(image, camera)| camera.small(image).flatten(1, -1))
            .collect();
        Self {
            image: spread(&Tensor::cat(&images, 1)),
            proprioception: spread(&statistics.proprioception.apply(&batch.proprioception)),
            action: spread(&statistics.action.apply(&batch.action)),
        }
    }

    /// Squared error of every element, `[W, L, 3]`, from features `[W, L, 3, d]`.
    pub(crate) fn errors(&self, network: &Network, features: &Tensor) -> Tensor {
        let heads = &network.heads;
        let image = heads.image(&Modality::Image.of(features));
        let proprioception = heads.proprioception(&Modality::Proprioception.of(features));
        let action = heads.action(&Modality::Action.of(features));
        let errors = [
            squared_error(&image, &self.image),
            squared_error(&proprioception, &self.proprioception),
            squared_error(&action, &self.action),
        ];
        Tensor::stack(&errors, -1)
    }
}

/// Mean over the last dimension of the squared difference.
pub(crate) fn squared_error(prediction: &Tensor, target: &Tensor) -> Tensor {
    (prediction - target).square().mean_dim([-1i64].as_slice(), false, None)
}

/// The paper's sum over elements, for each step of the segments: the sum of `errors` `[W, L, 3]` where `counted`
/// `[W, L, 3]` is true, over the number of steps where `valid` `[W, L]` is. Losses whose elements complement each other,
/// as those of MTP and TR do, therefore add up to the loss over all elements, each with weight 1.
fn sum_per_step(errors: &Tensor, counted: &Tensor, valid: &Tensor) -> Tensor {
    (errors * counted.to_kind(errors.kind())).sum(None) / valid.to_kind(errors.kind()).sum(None).clamp_min(1.0)
}
