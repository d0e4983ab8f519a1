//! The observations and actions themselves: all cameras' images down-sampled to the targets of H_o, proprioception and
//! actions, standardised by the model's statistics. No network pass.

use tch::Tensor;

use super::{CHUNK, Features, extend};
use crate::batch::{Batch, Segment, Segments};
use crate::error::LearnError;
use crate::model::Network;
use crate::trajectory::Trajectory;

/// Features of every segment's last step, or of all the steps of the `whole` segment. Each value is divided by the root
/// of its modality's width, so that o, m and a have equal weight for any sizes.
pub(super) fn features(network: &Network, trajectory: &Trajectory, whole: bool) -> Result<Features, LearnError> {
    let standard = steps(network, trajectory)?;
    let mut steps = Features::empty(standard.widths());
    steps.extend([0, 1, 2].map(|modality| {
        #[expect(clippy::cast_precision_loss, reason = "a step has far fewer values than 2^24")]
        let root = (standard.widths()[modality] as f32).sqrt();
        standard.values(modality).iter().map(|value| value / root).collect::<Vec<f32>>()
    }));
    Ok(if whole { windows(&steps, network.spec.window()) } else { steps })
}

/// Standardised o, m and a of every step.
pub(in crate::score) fn steps(network: &Network, trajectory: &Trajectory) -> Result<Features, LearnError> {
    let every = Segments::every(&[trajectory]).all();
    let parts = every.chunks(CHUNK).map(|chunk| standard(network, trajectory, chunk));
    let parts: Vec<[Tensor; 3]> = parts.collect::<Result<_, LearnError>>()?;
    let widths = [0, 1, 2].map(|i| parts.first().map_or(1, |part| usize::try_from(part[i].size()[1]).unwrap_or(1)));
    let mut features = Features::empty(widths);
    parts.iter().for_each(|part| extend(&mut features, part));
    Ok(features)
}

/// o, m and a of `chunk`, `[chunk.len(), width]` each.
fn standard(network: &Network, trajectory: &Trajectory, chunk: &[Segment]) -> Result<[Tensor; 3], LearnError> {
    let batch = Batch::collect(&network.shape, &[trajectory], chunk, 1, network.device())?;
    let statistics = &network.statistics;
    let cameras = batch.images.iter().zip(&statistics.cameras);
    let images: Vec<Tensor> = cameras.map(|(image, camera)| camera.small(image).flatten(1, -1)).collect();
    Ok([
        Tensor::cat(&images, 1),
        statistics.proprioception.apply(&batch.proprioception),
        statistics.action.apply(&batch.action),
    ])
}

/// The last `window` steps concatenated, for every step; places before the episode are zero.
fn windows(steps: &Features, window: usize) -> Features {
    let mut all = Features::empty(steps.widths().map(|width| width * window));
    all.extend([0, 1, 2].map(|modality| {
        let mut values = Vec::new();
        for last in 0..steps.count() {
            let padding = window.saturating_sub(last + 1);
            values.resize(values.len() + padding * steps.widths()[modality], 0.0);
            for step in last + 1 + padding - window..=last {
                values.extend_from_slice(steps.row(modality, step));
            }
        }
        values
    }));
    all
}
