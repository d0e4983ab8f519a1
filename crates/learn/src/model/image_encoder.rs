//! All cameras of a step to one embedding: an encoder per camera, a few convolutions or a residual network, then one
//! projection of all of them. Must not depend on the origin of weights.

mod blocks;
mod residual;
mod resnet;
mod token_grid;

pub(crate) use token_grid::TokenGrid;

use tch::nn::{self, ModuleT};
use tch::{Tensor, nn::Module};

use gleaner_core::{ImageEncoder as Kind, ModelSpec};

use super::Size;
use super::layers::Convolution;
use crate::batch::int;
use crate::shape::{CameraShape, TaskShape};

/// Stages halve an image until at most this many places are left.
const PLACES: i64 = 256;
const MIN_STAGES: usize = 2;
/// Larger images are shrunk by 4 in the first stage.
const LARGE: u32 = 64;
const GROUPS: i64 = 8;

/// The name of the image encoder's part of a model, the second in the names of its parameters.
pub(crate) const IMAGES: &str = "image";
/// The name of the cameras' parts of an image encoder.
const CAMERA: &str = "camera";

/// The name of a camera's ResNet: the names of torchvision follow it in those of parameters.
pub(super) const RESNET: &str = "resnet";

/// The image encoder of a task.
pub(crate) struct ImageEncoder {
    stages: ImageStages,
    /// Of each camera.
    keypoints: Vec<Keypoints>,
    project: nn::Linear,
}

impl ImageEncoder {
    pub(crate) fn new(path: &nn::Path<'_>, shape: &TaskShape, spec: &ModelSpec) -> Self {
        let stages = ImageStages::new(path, shape, spec);
        let keypoints: Vec<_> =
            (stages.sizes().enumerate()).map(|(i, size)| Keypoints::new(&(path / CAMERA / i), size)).collect();
        let inputs = keypoints.iter().map(Keypoints::outputs).sum();
        let project = nn::linear(path / "project", inputs, Size::of(spec.preset).width, Default::default());
        Self { stages, keypoints, project }
    }

    /// Standardised images, per camera `[N, C, H, W]`, to `[N, d]`.
    pub(crate) fn forward(&self, images: &[Tensor]) -> Tensor {
        let maps = self.stages.forward(images);
        let seen: Vec<Tensor> = (self.keypoints.iter().zip(&maps)).map(|(camera, map)| camera.forward(map)).collect();
        self.project.forward(&Tensor::cat(&seen, 1))
    }
}

/// The part of an image encoder before its keypoints: each camera's images to a feature map.
pub(crate) struct ImageStages {
    cameras: Vec<(nn::SequentialT, [i64; 3])>,
}

impl ImageStages {
    pub(crate) fn new(path: &nn::Path<'_>, shape: &TaskShape, spec: &ModelSpec) -> Self {
        let stages = |(i, camera): (usize, &CameraShape)| {
            let path = path / CAMERA / i;
            let size = [int(camera.channels()), camera.height.into(), camera.width.into()];
            match spec.image_encoder {
                Kind::Keypoints => convolutions(&path, Size::of(spec.preset).channels, size),
                Kind::Residual => residual::network(&(path / "residual"), spec.preset, size),
                Kind::Resnet18 => resnet::network(&(path / RESNET), [2, 2, 2, 2], size),
                Kind::Resnet34 => resnet::network(&(path / RESNET), [3, 4, 6, 3], size),
            }
        };
        Self { cameras: shape.cameras.iter().enumerate().map(stages).collect() }
    }

    /// Channels, height and width of each camera's map: at most 256 places, of a ResNet a 32nd of each side.
    pub(crate) fn sizes(&self) -> impl Iterator<Item = [i64; 3]> {
        self.cameras.iter().map(|(_, size)| *size)
    }

    /// Standardised images, per camera `[N, C, H, W]`, to the maps of the last stage, per camera `[N, C′, H′, W′]`.
    pub(crate) fn forward(&self, images: &[Tensor]) -> Vec<Tensor> {
        (self.cameras.iter().zip(images)).map(|((stages, _), image)| stages.forward_t(image, false)).collect()
    }
}

/// What one camera's map shows: each of its channels, after a layer of its own, detects one feature and returns its
/// position (the mean place under a softmax over all places) and the strength of the detection. Positions matter most
/// in manipulation, and this form learns them from few demonstrations.
struct Keypoints {
    detect: nn::Conv2D,
    /// `[places, 2]`: x and y of each place in -1 … 1.
    grid: Tensor,
    channels: i64,
}

impl Keypoints {
    fn new(path: &nn::Path<'_>, [channels, height, width]: [i64; 3]) -> Self {
        let detect = nn::conv2d(path / "keypoint", channels, channels, 1, Default::default());
        Self { detect, grid: grid(height, width, path.device()), channels }
    }

    fn outputs(&self) -> i64 {
        3 * self.channels
    }

    /// A map `[N, C′, H′, W′]` to `[N, outputs]`.
    fn forward(&self, map: &Tensor) -> Tensor {
        let seen = self.detect.forward(map).flatten(2, -1);
        let attention = seen.softmax(-1, None);
        let place = attention.matmul(&self.grid.to_kind(seen.kind())).flatten(1, -1);
        let clearness = (attention * seen).sum_dim_intlist([-1i64].as_slice(), false, None);
        Tensor::cat(&[place, clearness], 1)
    }
}

/// Stages of convolutions for images of `channels` and of this height and width; and the channels, height and width of
/// their output. The last number `of_stages` repeats.
fn convolutions(
    path: &nn::Path<'_>,
    of_stages: &[i64],
    [mut channels, mut height, mut width]: [i64; 3],
) -> (nn::SequentialT, [i64; 3]) {
    let mut stages = nn::seq_t();
    let large = height.max(width) > i64::from(LARGE);
    let mut stage = 0;
    while stage < MIN_STAGES || height * width > PLACES {
        let stride = if stage == 0 && large {
            4
        } else if height * width > PLACES {
            2
        } else {
            1
        };
        let out = of_stages[stage.min(of_stages.len() - 1)];
        stages = add_stage(stages, &(path / stage), [channels, out, stride]);
        (height, width) = ((height + stride - 1) / stride, (width + stride - 1) / stride);
        channels = out;
        stage += 1;
    }
    (stages, [channels, height, width])
}

/// Convolution, group norm and ReLU. A side of any length shrinks to ceil(side / stride).
fn add_stage(stages: nn::SequentialT, path: &nn::Path<'_>, [inputs, outputs, stride]: [i64; 3]) -> nn::SequentialT {
    let kernel = if stride == 4 { 5 } else { 3 };
    stages
        .add(Convolution::new(path / "conv", [inputs, outputs, kernel, stride]))
        .add(nn::group_norm(path / "norm", GROUPS, outputs, Default::default()))
        .add_fn(Tensor::relu)
}

fn grid(height: i64, width: i64, device: tch::Device) -> Tensor {
    let line = |count| Tensor::linspace(-1.0, 1.0, count, (tch::Kind::Float, device));
    let x = line(width).unsqueeze(0).expand([height, width], false);
    let y = line(height).unsqueeze(1).expand([height, width], false);
    Tensor::stack(&[x, y], -1).view([height * width, 2])
}

#[cfg(test)]
mod tests {
    use gleaner_core::Words as _;
    use tch::Device;

    use super::*;

    #[test]
    fn any_image_size_is_taken() {
        let sizes = [(8, 8, false), (16, 17, true), (128, 128, true), (270, 480, false)];
        let kinds = Kind::ALL.iter().map(|word| word.value);
        for ((height, width, depth), image_encoder) in
            sizes.into_iter().flat_map(|size| kinds.clone().map(move |kind| (size, kind)))
        {
            let shape = TaskShape {
                cameras: vec![CameraShape { name: "c".into(), height, width, depth, recorded: None }],
                proprioception: 1,
                action: 1,
                ranges: gleaner_core::action::ActionRanges::default(),
            };
            let store = nn::VarStore::new(Device::Cpu);
            let encoder =
                ImageEncoder::new(&store.root(), &shape, &ModelSpec { image_encoder, ..ModelSpec::default() });
            let channels = if depth { 4 } else { 3 };
            let size = [2, channels, i64::from(height), i64::from(width)];
            let out = encoder.forward(&[Tensor::zeros(size, (tch::Kind::Float, Device::Cpu))]);
            assert_eq!(out.size(), [2, 64]);
        }
    }
}
