//! Features of an episode's segments: z^o, z^m, z^a of the last step of the unmasked,
//! bidirectional pass. Every frame is encoded once.

use tch::Tensor;

use crate::batch::{Batch, Segment, Segments, Windows, values};
use crate::model::{Modality, Network, View};
use crate::trajectory::Trajectory;

/// Steps encoded, and windows passed, at a time: bounds memory, and being fixed it gives an
/// episode the same features whatever it is scored with.
const CHUNK: usize = 128;

/// Last-step features of T segments, row-major in single precision.
#[derive(Debug, Clone)]
pub(crate) struct Features {
    /// For o, m, a: `T * d` values.
    pub(crate) values: [Vec<f32>; 3],
    /// d.
    pub(crate) width: usize,
}

impl Features {
    /// Number of segments T.
    pub(crate) fn count(&self) -> usize {
        self.values[0].len() / self.width.max(1)
    }

    /// Feature `modality` of segment `at`.
    pub(crate) fn row(&self, modality: usize, at: usize) -> &[f32] {
        &self.values[modality][at * self.width..(at + 1) * self.width]
    }

    /// Whether every value is a number whose square does not overflow when many are summed.
    pub(crate) fn sound(&self) -> bool {
        self.values.iter().flatten().all(|value| value.abs() < 1e15)
    }
}

/// The features of every segment of `trajectory`.
pub(crate) fn episode_features(network: &Network, trajectory: &Trajectory) -> Features {
    let every = Segments::every(&network.shape, &[trajectory]);
    let steps: Vec<Tensor> = every.all().chunks(CHUNK).map(|chunk| encode(network, trajectory, chunk)).collect();
    let steps = Tensor::cat(&steps, 0);
    let mut features = Features { values: Default::default(), width: network.width() };
    for chunk in every.all().chunks(CHUNK) {
        let (windows, needed) = Windows::lay_out(chunk, network.spec.window(), network.device());
        let needed: Vec<i64> = needed.iter().map(|(_, t)| crate::batch::int(*t)).collect();
        let needed = Tensor::from_slice(&needed).to_device(network.device());
        let steps = steps.index_select(0, &needed);
        let last = network.features(&steps, &windows, View::WHOLE, 1).select(1, 0);
        let modalities = [Modality::Image, Modality::Proprioception, Modality::Action];
        for (all, modality) in features.values.iter_mut().zip(modalities) {
            all.extend(values(&modality.of(&last)));
        }
    }
    features
}

/// The steps of `chunk`, `[chunk.len(), 3, d]`.
fn encode(network: &Network, trajectory: &Trajectory, chunk: &[Segment]) -> Tensor {
    let batch = Batch::collect(&network.shape, &[trajectory], chunk, 1, network.device());
    network.batch_steps(&batch)
}
