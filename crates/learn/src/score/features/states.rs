//! States of an episode's steps: what the cameras and the robot report, before attention, whose features contain the
//! actions. Independent of scores.

use tch::{Device, Tensor, no_grad_guard};

use super::{CHUNK, too_far};
use crate::batch::{Batch, Segments, values};
use crate::error::LearnError;
use crate::model::Network;
use crate::trajectory::Trajectory;

/// The image embedding beside standardised proprioception of every step, `[T, d + M]`, in the memory of the processor:
/// a large run has more states than a device has memory for.
///
/// # Errors
/// [`LearnError::Invalid`] for a state that is not finite; [`LearnError::Steps`].
pub(in crate::score) fn states(network: &Network, trajectory: &Trajectory) -> Result<Tensor, LearnError> {
    let _no_grad = no_grad_guard();
    let every = Segments::every(&[trajectory]).all();
    let chunks = every.chunks(CHUNK).map(|chunk| {
        let batch = Batch::collect(&network.shape, &[trajectory], chunk, 1, network.device())?;
        let proprioception = network.statistics.proprioception.apply(&batch.proprioception);
        Ok(Tensor::cat(&[network.embed_images(&batch.images), proprioception], 1))
    });
    let states = Tensor::cat(&chunks.collect::<Result<Vec<_>, LearnError>>()?, 0).to_device(Device::Cpu);
    if values(&states).iter().all(|value| value.is_finite()) { Ok(states) } else { Err(too_far(&trajectory.id)) }
}
