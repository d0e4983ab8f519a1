//! The observations and actions themselves: all cameras' images down-sampled, proprioception and actions, standardised
//! by the model's statistics. No network pass.

use gleaner_search::PointShape;
use tch::Tensor;

use super::{Episode, Features, extend, padding, read};
use crate::batch::{Batch, images, int};
use crate::error::LearnError;
use crate::history::Stacked;
use crate::model::Network;
use crate::normalize::target_size;
use crate::shape::CameraShape;
use crate::trajectory::Trajectory;

/// Most pixels of a down-sampled image's side: the target of H_o in the smallest preset, so that larger models neither
/// change the score nor multiply its memory.
const SIDE: u32 = 8;

/// Number of values of a step, per modality.
pub(super) fn step_widths(network: &Network) -> [usize; 3] {
    let values = |camera: &CameraShape| {
        let [height, width] = target_size(camera, SIDE).map(|side| usize::try_from(side).unwrap_or(0));
        camera.channels() * height * width
    };
    [network.shape.cameras.iter().map(values).sum(), network.shape.proprioception, network.shape.action]
}

/// Frames, each with the layout of one step of [`StepSource`](crate::StepSource), to the values of o, `[N, width]`.
pub(super) fn embed_frames(network: &Network, frames: &[&[u8]]) -> Tensor {
    small(network, &images(&network.shape, frames, network.device()))
}

/// The shape of segments' last `keep` steps.
pub(super) fn shape(network: &Network, keep: usize) -> PointShape {
    PointShape { widths: step_widths(network), length: keep }
}

/// Features of every segment's last `keep` steps; zero for places before the episode.
pub(super) fn features(network: &Network, mut episode: Episode<'_>, keep: usize) -> Result<Features, LearnError> {
    let steps = standard(network, &mut episode)?.map(alike);
    let mut features = Features::empty(shape(network, keep));
    extend(&mut features, &steps.map(|steps| steps.constant_pad_nd([0, 0, int(keep - 1), 0])));
    Ok(features)
}

/// Features of the last `keep` steps of each history in `stacked`, whose embeddings are of [`embed_frames`].
pub(super) fn newest(network: &Network, stacked: &Stacked, keep: usize) -> Features {
    let statistics = &network.statistics;
    let steps = [
        stacked.embedded.shallow_clone(),
        statistics.proprioception.apply(&stacked.proprioception),
        statistics.action.apply(&stacked.action),
    ];
    let (newest, padding) = (stacked.windows.newest(keep), padding(&stacked.windows, keep));
    let windows = steps.map(|steps| {
        let width = steps.size()[1];
        let kept = alike(steps.index_select(0, &newest)).view([-1, int(keep), width]);
        kept.masked_fill(&padding, 0.0)
    });
    let mut features = Features::empty(shape(network, keep));
    for at in 0..windows[0].size()[0] {
        extend(&mut features, &windows.each_ref().map(|windows| windows.get(at)));
    }
    features
}

/// Standardised o, m and a of every step.
pub(in crate::score) fn steps(network: &Network, trajectory: &Trajectory) -> Result<Features, LearnError> {
    let mut features = Features::empty(step_widths(network));
    extend(&mut features, &read(network, trajectory, |mut episode| standard(network, &mut episode))?);
    Ok(features)
}

/// Rows `[N, width]`, divided by the root of their width, so that o, m and a have equal weight for any sizes.
fn alike(rows: Tensor) -> Tensor {
    #[expect(clippy::cast_precision_loss, reason = "a step has far fewer values than 2^53")]
    let root = (rows.size()[1] as f64).sqrt();
    rows / root
}

/// Standardised o, m and a of every step, `[T, width]` each.
fn standard(network: &Network, episode: &mut Episode<'_>) -> Result<[Tensor; 3], LearnError> {
    let parts = episode.each(|chunk| standard_chunk(network, chunk))?;
    Ok([0, 1, 2].map(|modality| Tensor::cat(&parts.iter().map(|part| &part[modality]).collect::<Vec<_>>(), 0)))
}

fn standard_chunk(network: &Network, chunk: &Batch) -> [Tensor; 3] {
    let statistics = &network.statistics;
    [
        small(network, &chunk.images),
        statistics.proprioception.apply(&chunk.proprioception),
        statistics.action.apply(&chunk.action),
    ]
}

/// Images, per camera `[N, C, H, W]`, to the down-sampled and standardised values of all cameras, `[N, width]`.
fn small(network: &Network, images: &[Tensor]) -> Tensor {
    let cameras = images.iter().zip(&network.statistics.cameras).zip(&network.shape.cameras);
    let small = cameras.map(|((images, standard), camera)| {
        let small = standard.small(images);
        let side = target_size(camera, SIDE);
        let small = if small.size()[2..] == side { small } else { small.adaptive_avg_pool2d(side) };
        small.flatten(1, -1)
    });
    Tensor::cat(&small.collect::<Vec<_>>(), 1)
}
