//! A camera's ResNet with the layers, names and shapes of torchvision, so that weights made for those fit. Its batch
//! norms are affine maps by given statistics, which never change, as in DETR and ACT: an output does not depend on the
//! batch. Must not depend on the files that hold such weights.

use tch::Tensor;
use tch::nn::{self, Module};

use super::blocks::{self, Names, Style};

/// Added to variances, as torchvision's norms do.
const EPSILON: f64 = 1e-5;

/// A batch norm that only acts: neither its statistics nor its affine map are trained.
#[derive(Debug)]
struct FrozenNorm {
    weight: Tensor,
    bias: Tensor,
    mean: Tensor,
    variance: Tensor,
}

impl FrozenNorm {
    fn new(path: &nn::Path<'_>, channels: i64) -> Self {
        Self {
            weight: path.ones_no_train("weight", &[channels]),
            bias: path.zeros_no_train("bias", &[channels]),
            mean: path.zeros_no_train("running_mean", &[channels]),
            variance: path.ones_no_train("running_var", &[channels]),
        }
    }
}

impl Module for FrozenNorm {
    fn forward(&self, x: &Tensor) -> Tensor {
        let Self { weight, bias, mean, variance } = self;
        x.batch_norm(Some(weight), Some(bias), Some(mean), Some(variance), false, 0.0, EPSILON, false)
    }
}

/// The network with this number of blocks in each stage, for images of `channels` and of this height and width; and the
/// channels, height and width of its output, a 32nd of the images.
pub(super) fn network(path: &nn::Path<'_>, blocks: [usize; 4], size: [i64; 3]) -> (nn::SequentialT, [i64; 3]) {
    let names = Names {
        stem: ["conv1", "bn1"],
        block: |path, stage, block| path / format!("layer{}", stage + 1) / block,
        convolutions: ["conv1", "conv2"],
        norms: ["bn1", "bn2"],
        shortcut: |path| [path / "downsample" / 0, path / "downsample" / 1],
    };
    let norm = |path: nn::Path<'_>, channels| -> Box<dyn Module> { Box::new(FrozenNorm::new(&path, channels)) };
    let style = Style { channels: 64, blocks, norm: &norm, shrinking_stem: true, halves: |_| true, names };
    blocks::network(path, &style, size)
}

#[cfg(test)]
mod tests;
