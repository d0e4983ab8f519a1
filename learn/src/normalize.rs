//! Standardisation: mean and deviation of everything the model reads or predicts, measured once
//! over D_u and kept in every checkpoint. Knows nothing of the model.

use std::collections::BTreeMap;

use tch::{Device, Kind, Tensor};

use crate::batch::{images, int, rows};
use crate::error::LearnError;
use crate::spec::{CameraShape, TaskShape};
use crate::trajectory::Trajectory;

/// Images looked at for the image statistics; an even sample of the steps when there are more.
const SAMPLED_FRAMES: usize = 2_048;
const CHUNK: usize = 64;
/// A deviation below this part of the values' size is rounding noise: the dimension is constant.
const CONSTANT: f64 = 1e-6;

/// `(x - mean) / deviation`, and back.
pub(crate) struct Standard {
    mean: Tensor,
    deviation: Tensor,
}

/// Statistics of one camera's images.
pub(crate) struct CameraStandard {
    /// What the image encoder reads: per channel, `[C, 1, 1]`.
    pub(crate) input: Standard,
    /// What H_o predicts: the down-sampled image less its mean image `[C, h, w]`, in units of the
    /// channel's remaining deviation `[C, 1, 1]`. So the static background costs nothing, and a
    /// pixel that hardly ever changes is not blown up.
    pub(crate) target: Standard,
}

impl CameraStandard {
    /// What H_o should predict, `[N, C, h, w]`, for images `[N, C, H, W]`.
    pub(crate) fn small(&self, images: &Tensor) -> Tensor {
        let size = self.target.mean.size();
        self.target.apply(&images.adaptive_avg_pool2d(&size[1..]))
    }
}

/// All statistics of a data set.
pub(crate) struct Statistics {
    /// Per dimension of m, `[M]`.
    pub(crate) proprioception: Standard,
    /// Per dimension of a, `[A]`.
    pub(crate) action: Standard,
    /// Per camera.
    pub(crate) cameras: Vec<CameraStandard>,
}

impl Standard {
    /// Standardises `x`.
    pub(crate) fn apply(&self, x: &Tensor) -> Tensor {
        (x - &self.mean) / &self.deviation
    }

    /// Back to physical units.
    pub(crate) fn invert(&self, x: &Tensor) -> Tensor {
        x * &self.deviation + &self.mean
    }

    /// From doubles. Where the deviation is noise beside `size` it becomes 1, so that a constant
    /// dimension is only centred and its scale passes through.
    fn new(mean: &Tensor, deviation: &Tensor, size: &Tensor, device: Device) -> Self {
        let noise = (size.abs() + 1.0) * CONSTANT;
        let deviation = deviation.where_self(&deviation.gt_tensor(&noise), &deviation.ones_like());
        Self {
            mean: mean.to_kind(Kind::Float).to_device(device),
            deviation: deviation.to_kind(Kind::Float).to_device(device),
        }
    }

    /// Per dimension of `[T, D]`.
    fn of_rows(rows: &Tensor, device: Device) -> Self {
        let rows = rows.to_kind(Kind::Double);
        let mean = rows.mean_dim([0i64].as_slice(), false, Kind::Double);
        let deviation = (&rows - &mean)
            .square()
            .mean_dim([0i64].as_slice(), false, Kind::Double)
            .sqrt();
        Self::new(&mean, &deviation, &mean, device)
    }

    fn name_into(&self, prefix: &str, named: &mut Vec<(String, Tensor)>) {
        named.push((format!("{prefix}.mean"), self.mean.shallow_clone()));
        named.push((
            format!("{prefix}.deviation"),
            self.deviation.shallow_clone(),
        ));
    }

    fn from_named(
        prefix: &str,
        sizes: [&[i64]; 2],
        named: &BTreeMap<String, Tensor>,
        device: Device,
    ) -> Result<Self, LearnError> {
        let take = |name: &str, size: &[i64]| {
            let name = format!("{prefix}.{name}");
            match named.get(&name) {
                Some(tensor) if tensor.size() == size => Ok(tensor.to_device(device)),
                _ => Err(LearnError::Checkpoint(format!(
                    "`{name}` is missing or does not have size {size:?}"
                ))),
            }
        };
        Ok(Self {
            mean: take("mean", sizes[0])?,
            deviation: take("deviation", sizes[1])?,
        })
    }
}

impl Statistics {
    /// Measures `data`. Images are down-sampled to at most `target` a side for H_o.
    pub(crate) fn measure(
        shape: &TaskShape,
        data: &[&Trajectory],
        target: u32,
        device: Device,
    ) -> Self {
        let gather = |field: fn(&Trajectory) -> &[f32], width: usize| {
            let all: Vec<f32> = data.iter().flat_map(|t| field(t)).copied().collect();
            Standard::of_rows(&rows(&all, width, Device::Cpu), device)
        };
        Self {
            proprioception: gather(|t| &t.proprioception, shape.proprioception),
            action: gather(|t| &t.action, shape.action),
            cameras: measure_cameras(shape, data, target, device),
        }
    }

    /// Every tensor with its name in a checkpoint.
    pub(crate) fn named(&self) -> Vec<(String, Tensor)> {
        let mut named = Vec::new();
        self.proprioception
            .name_into("statistics.proprioception", &mut named);
        self.action.name_into("statistics.action", &mut named);
        for (i, camera) in self.cameras.iter().enumerate() {
            camera
                .input
                .name_into(&format!("statistics.camera.{i}.input"), &mut named);
            camera
                .target
                .name_into(&format!("statistics.camera.{i}.target"), &mut named);
        }
        named
    }

    /// The inverse of [`Statistics::named`].
    pub(crate) fn from_named(
        shape: &TaskShape,
        target: u32,
        named: &BTreeMap<String, Tensor>,
        device: Device,
    ) -> Result<Self, LearnError> {
        let vector = |name: &str, width: usize| {
            let size = [int(width)];
            let prefix = format!("statistics.{name}");
            Standard::from_named(&prefix, [&size, &size], named, device)
        };
        let camera = |(i, camera): (usize, &CameraShape)| {
            let channels = int(camera.channels());
            let each = [channels, 1, 1];
            let [height, width] = target_size(camera, target);
            let prefix = format!("statistics.camera.{i}");
            Ok(CameraStandard {
                input: Standard::from_named(
                    &format!("{prefix}.input"),
                    [&each, &each],
                    named,
                    device,
                )?,
                target: Standard::from_named(
                    &format!("{prefix}.target"),
                    [&[channels, height, width], &each],
                    named,
                    device,
                )?,
            })
        };
        Ok(Self {
            proprioception: vector("proprioception", shape.proprioception)?,
            action: vector("action", shape.action)?,
            cameras: shape
                .cameras
                .iter()
                .enumerate()
                .map(camera)
                .collect::<Result<_, LearnError>>()?,
        })
    }
}

/// Height and width of the image H_o predicts.
pub(crate) fn target_size(camera: &CameraShape, target: u32) -> [i64; 2] {
    [camera.height, camera.width].map(|side| i64::from(side.min(target)))
}

/// Sums over the sampled images of one camera.
struct Sums {
    channel: Tensor,
    channel_square: Tensor,
    target: Tensor,
    target_square: Tensor,
}

fn measure_cameras(
    shape: &TaskShape,
    data: &[&Trajectory],
    target: u32,
    device: Device,
) -> Vec<CameraStandard> {
    let steps: Vec<(usize, usize)> = data
        .iter()
        .enumerate()
        .flat_map(|(i, t)| (0..t.steps(shape)).map(move |step| (i, step)))
        .collect();
    let every = steps.len().div_ceil(SAMPLED_FRAMES).max(1);
    let sample: Vec<_> = steps.into_iter().step_by(every).collect();
    let mut sums: Vec<Option<Sums>> = shape.cameras.iter().map(|_| None).collect();
    for chunk in sample.chunks(CHUNK) {
        let frames: Vec<&[u8]> = chunk
            .iter()
            .map(|(i, t)| data[*i].frame(shape, *t))
            .collect();
        for (i, image) in images(shape, &frames, device).iter().enumerate() {
            let size = target_size(&shape.cameras[i], target);
            let part = Sums::of(image, size);
            sums[i] = Some(match sums[i].take() {
                Some(sum) => sum.plus(&part),
                None => part,
            });
        }
    }
    let count = f64::from(u32::try_from(sample.len()).unwrap_or(u32::MAX));
    let finish = |sums: Sums| sums.standard(count, device);
    sums.into_iter().flatten().map(finish).collect()
}

impl Sums {
    /// Of `[N, C, H, W]`; pixels are averaged, images are summed.
    fn of(images: &Tensor, size: [i64; 2]) -> Self {
        let mean = |x: &Tensor| {
            x.mean_dim([2i64, 3].as_slice(), true, Kind::Double)
                .sum_dim_intlist([0i64].as_slice(), false, Kind::Double)
        };
        let small = images.adaptive_avg_pool2d(size).to_kind(Kind::Double);
        Self {
            channel: mean(images),
            channel_square: mean(&images.square()),
            target: small.sum_dim_intlist([0i64].as_slice(), false, Kind::Double),
            target_square: mean(&small.square()),
        }
    }

    fn plus(&self, other: &Self) -> Self {
        Self {
            channel: &self.channel + &other.channel,
            channel_square: &self.channel_square + &other.channel_square,
            target: &self.target + &other.target,
            target_square: &self.target_square + &other.target_square,
        }
    }

    fn standard(&self, count: f64, device: Device) -> CameraStandard {
        let deviation = |square: Tensor| square.clamp_min(0.0).sqrt();
        let channel = &self.channel / count;
        let spread = deviation(&self.channel_square / count - channel.square());
        let target = &self.target / count;
        let still = target
            .square()
            .mean_dim([1i64, 2].as_slice(), true, Kind::Double);
        let moving = deviation(&self.target_square / count - still);
        let size = spread.zeros_like();
        CameraStandard {
            input: Standard::new(&channel, &spread, &size, device),
            target: Standard::new(&target, &moving, &size, device),
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;
    use crate::batch::values;

    #[test]
    fn a_constant_dimension_is_centred_and_keeps_its_scale() {
        let data = rows(&[1.0, 0.1, 3.0, 0.1], 2, Device::Cpu);
        let standard = Standard::of_rows(&data, Device::Cpu);
        assert_eq!(values(&standard.apply(&data)), [-1.0, 0.0, 1.0, 0.0]);
        let off = rows(&[2.0, 0.6], 2, Device::Cpu);
        assert_eq!(values(&standard.apply(&off)), [0.0, 0.5]);
        let back = standard.invert(&standard.apply(&data));
        assert_eq!(values(&back), values(&data));
    }

    #[test]
    fn a_still_image_is_the_mean_image_and_movement_has_unit_deviation() {
        let still = Tensor::from_slice(&[0.2f32, 0.8, 0.2, 0.8]).view([2, 1, 1, 2]);
        let sums = Sums::of(&still, [1, 2]);
        let standard = sums.standard(2.0, Device::Cpu);
        assert_eq!(values(&standard.target.apply(&still)), [0.0; 4]);
        let moving = Tensor::from_slice(&[0.0f32, 1.0, 1.0, 0.0]).view([2, 1, 1, 2]);
        let standard = Sums::of(&moving, [1, 2]).standard(2.0, Device::Cpu);
        assert_eq!(
            values(&standard.target.apply(&moving)),
            [-1.0, 1.0, 1.0, -1.0]
        );
    }
}
