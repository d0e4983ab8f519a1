//! All cameras of a step to one embedding: a small convolutional encoder per camera, then one
//! projection of all of them.

use tch::nn::{self, ModuleT};
use tch::{Tensor, nn::Module};

use super::Size;
use crate::spec::{CameraShape, TaskShape};

/// Stages halve an image until at most this many places are left; the places are kept apart (no
/// pooling over them), because where a thing is matters more than what it is.
const PLACES: i64 = 64;
const MIN_STAGES: usize = 2;
/// Larger images are shrunk by 4 in the first stage.
const LARGE: u32 = 64;
const GROUPS: i64 = 8;

/// The image encoder of a task.
pub(crate) struct ImageEncoder {
    cameras: Vec<nn::SequentialT>,
    project: nn::Linear,
}

impl ImageEncoder {
    pub(super) fn new(path: &nn::Path<'_>, shape: &TaskShape, size: &Size) -> Self {
        let mut flat = 0;
        let mut cameras = Vec::with_capacity(shape.cameras.len());
        for (i, camera) in shape.cameras.iter().enumerate() {
            let (encoder, width) = camera_encoder(&(path / "camera" / i), camera, size);
            cameras.push(encoder);
            flat += width;
        }
        let project = nn::linear(path / "project", flat, size.width, Default::default());
        Self { cameras, project }
    }

    /// Standardised images, per camera `[N, C, H, W]`, to `[N, d]`.
    pub(super) fn forward(&self, images: &[Tensor]) -> Tensor {
        let flat: Vec<Tensor> = self
            .cameras
            .iter()
            .zip(images)
            .map(|(camera, image)| camera.forward_t(image, false).flatten(1, -1))
            .collect();
        self.project.forward(&Tensor::cat(&flat, 1))
    }
}

/// The stages for `camera` and how many values they give.
fn camera_encoder(
    path: &nn::Path<'_>,
    camera: &CameraShape,
    size: &Size,
) -> (nn::SequentialT, i64) {
    let mut encoder = nn::seq_t();
    let (mut height, mut width) = (i64::from(camera.height), i64::from(camera.width));
    let mut channels = if camera.depth { 4 } else { 3 };
    let mut stage = 0;
    while stage < MIN_STAGES || height * width > PLACES {
        let stride = if stage == 0 && camera.height.max(camera.width) > LARGE {
            4
        } else {
            2
        };
        let out = size.channels[stage.min(size.channels.len() - 1)];
        let path = path / stage;
        // With this kernel and padding a side shrinks to ceil(side / stride), whatever it was.
        let config = nn::ConvConfig {
            stride,
            padding: stride / 2,
            bias: false,
            ..Default::default()
        };
        encoder = encoder
            .add(nn::conv2d(
                &path / "conv",
                channels,
                out,
                stride + 1,
                config,
            ))
            .add(nn::group_norm(
                &path / "norm",
                GROUPS,
                out,
                Default::default(),
            ))
            .add_fn(Tensor::relu);
        (height, width) = (
            (height + stride - 1) / stride,
            (width + stride - 1) / stride,
        );
        channels = out;
        stage += 1;
    }
    (encoder, channels * height * width)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use tch::{Device, Kind};

    use super::*;
    use crate::spec::Preset;

    #[test]
    fn any_image_size_is_taken() {
        for (height, width, depth) in [
            (8, 8, false),
            (16, 17, true),
            (128, 128, true),
            (270, 480, false),
        ] {
            let shape = TaskShape {
                cameras: vec![CameraShape {
                    name: "c".into(),
                    height,
                    width,
                    depth,
                }],
                proprioception: 1,
                action: 1,
            };
            let store = nn::VarStore::new(Device::Cpu);
            let encoder = ImageEncoder::new(&store.root(), &shape, &Size::of(Preset::Tiny));
            let channels = if depth { 4 } else { 3 };
            let size = [2, channels, i64::from(height), i64::from(width)];
            let out = encoder.forward(&[Tensor::zeros(size, (Kind::Float, Device::Cpu))]);
            assert_eq!(out.size(), [2, 64]);
        }
    }
}
