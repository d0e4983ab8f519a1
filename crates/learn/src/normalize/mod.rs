//! Standardisation: mean and deviation of everything the model reads or predicts, measured once
//! over D_u and kept in every checkpoint. Independent of the model.

mod cameras;
mod features;
mod frames;

pub(crate) use cameras::target_size;
pub(crate) use features::FeatureScale;

use std::collections::BTreeMap;

use tch::{Device, Kind, Tensor};

use crate::batch::{int, rows};
use crate::error::LearnError;
use crate::shape::{CameraShape, TaskShape};
use crate::trajectory::Trajectory;
use cameras::CameraStandard;
use frames::Lookup;

/// A deviation below this part of the values' magnitude is rounding noise: the dimension is constant.
const CONSTANT: f64 = 1e-6;

/// `(x - mean) / deviation`, and back.
pub(crate) struct Standard {
    mean: Tensor,
    deviation: Tensor,
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

    /// Statistics from doubles. Where the deviation is noise relative to `size`, it becomes 1, so that a constant
    /// dimension is only centred and its scale is unchanged.
    fn new(mean: &Tensor, deviation: &Tensor, size: &Tensor, device: Device) -> Self {
        let noise = (size.abs() + 1.0) * CONSTANT;
        let deviation = deviation.where_self(&deviation.gt_tensor(&noise), &deviation.ones_like());
        Self {
            mean: mean.to_kind(Kind::Float).to_device(device),
            deviation: deviation.to_kind(Kind::Float).to_device(device),
        }
    }

    /// Statistics per dimension of `[T, D]`.
    fn of_rows(rows: &Tensor, device: Device) -> Self {
        let rows = rows.to_kind(Kind::Double);
        let mean = rows.mean_dim([0i64].as_slice(), false, Kind::Double);
        let deviation = (&rows - &mean).square().mean_dim([0i64].as_slice(), false, Kind::Double).sqrt();
        Self::new(&mean, &deviation, &mean, device)
    }

    fn name_into(&self, prefix: &str, named: &mut Vec<(String, Tensor)>) {
        named.push((format!("{prefix}.mean"), self.mean.shallow_clone()));
        named.push((format!("{prefix}.deviation"), self.deviation.shallow_clone()));
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
                _ => Err(LearnError::Checkpoint(format!("`{name}` is missing or does not have size {size:?}"))),
            }
        };
        Ok(Self { mean: take("mean", sizes[0])?, deviation: take("deviation", sizes[1])? })
    }
}

impl Statistics {
    /// Measures `data`. Images are down-sampled to at most `target` a side for H_o.
    pub(crate) fn measure(shape: &TaskShape, data: &[&Trajectory], target: u32, device: Device) -> Self {
        let gather = |field: fn(&Trajectory) -> &[f32], width: usize| {
            let all: Vec<f32> = data.iter().flat_map(|t| field(t)).copied().collect();
            Standard::of_rows(&rows(&all, width, Device::Cpu), device)
        };
        Self {
            proprioception: gather(|t| &t.proprioception, shape.proprioception),
            action: gather(|t| &t.action, shape.action),
            cameras: cameras::measure(shape, data, target, device),
        }
    }

    /// Standardises images, per camera `[N, C, H, W]`, for the image encoder.
    pub(crate) fn images(&self, images: &[Tensor]) -> Vec<Tensor> {
        images.iter().zip(&self.cameras).map(|(image, camera)| camera.input.apply(image)).collect()
    }

    /// Every tensor with its name in a checkpoint.
    pub(crate) fn named(&self) -> Vec<(String, Tensor)> {
        let mut named = Vec::new();
        self.proprioception.name_into("statistics.proprioception", &mut named);
        self.action.name_into("statistics.action", &mut named);
        for (i, camera) in self.cameras.iter().enumerate() {
            camera.input.name_into(&format!("statistics.camera.{i}.input"), &mut named);
            camera.target.name_into(&format!("statistics.camera.{i}.target"), &mut named);
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
                input: Standard::from_named(&format!("{prefix}.input"), [&each, &each], named, device)?,
                target: Standard::from_named(
                    &format!("{prefix}.target"),
                    [&[channels, height, width], &each],
                    named,
                    device,
                )?,
                lookup: Lookup::default(),
            })
        };
        Ok(Self {
            proprioception: vector("proprioception", shape.proprioception)?,
            action: vector("action", shape.action)?,
            cameras: shape.cameras.iter().enumerate().map(camera).collect::<Result<_, LearnError>>()?,
        })
    }
}

#[cfg(test)]
mod tests {
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
}
