//! Standardisation of values: their mean and deviation. Independent of what they are values of.

use std::collections::BTreeMap;

use tch::{Device, Kind, Tensor};

use super::CONSTANT;
use crate::error::LearnError;

/// `(x - mean) / deviation`, and back.
pub(crate) struct Standard {
    pub(super) mean: Tensor,
    pub(super) deviation: Tensor,
}

impl Standard {
    /// The same statistics for another thread.
    pub(crate) fn shared(&self) -> Self {
        Self { mean: self.mean.shallow_clone(), deviation: self.deviation.shallow_clone() }
    }

    /// Standardises `x`.
    pub(crate) fn apply(&self, x: &Tensor) -> Tensor {
        (x - &self.mean) / &self.deviation
    }

    /// 1 for each value that varies and 0 for a constant one, whose deviation was set to exactly 1.
    pub(crate) fn varies(&self) -> Tensor {
        self.deviation.ne(1.0).to_kind(Kind::Float)
    }

    /// Back to physical units.
    pub(crate) fn invert(&self, x: &Tensor) -> Tensor {
        x * &self.deviation + &self.mean
    }

    /// Statistics from doubles. Where the deviation is noise relative to `size`, it becomes 1, so that a constant
    /// dimension is only centred and its scale is unchanged. A real deviation of 1 becomes the next number.
    pub(super) fn new(mean: &Tensor, deviation: &Tensor, size: &Tensor, device: Device) -> Self {
        let noise = (size.abs() + 1.0) * CONSTANT;
        let varies = deviation.gt_tensor(&noise);
        let deviation = deviation.to_kind(Kind::Float);
        let next = deviation.where_self(&deviation.ne(1.0), &deviation.full_like(f64::from(1f32.next_up())));
        Self {
            mean: mean.to_kind(Kind::Float).to_device(device),
            deviation: next.where_self(&varies, &deviation.ones_like()).to_device(device),
        }
    }

    pub(super) fn name_into(&self, prefix: &str, named: &mut Vec<(String, Tensor)>) {
        named.push((format!("{prefix}.mean"), self.mean.shallow_clone()));
        named.push((format!("{prefix}.deviation"), self.deviation.shallow_clone()));
    }

    pub(super) fn from_named(
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::batch::{rows, values};

    #[test]
    fn a_dimension_whose_deviation_is_one_varies() {
        let standard = Standard::of_rows([[-1.0f32, 3.0], [1.0, 3.0]].iter().map(|row| &row[..]), 2, Device::Cpu);
        assert_eq!(values(&standard.varies()), [1.0, 0.0]);
    }

    #[test]
    fn a_constant_dimension_is_centred_and_keeps_its_scale() {
        let data = [1.0f32, 0.1, 5.0, 0.1];
        let standard = Standard::of_rows(data.chunks(2), 2, Device::Cpu);
        let data = rows(&data, 2, Device::Cpu);
        assert_eq!(values(&standard.apply(&data)), [-1.0, 0.0, 1.0, 0.0]);
        let off = rows(&[2.0, 0.6], 2, Device::Cpu);
        assert_eq!(values(&standard.apply(&off)), [-0.5, 0.5]);
        let back = standard.invert(&standard.apply(&data));
        assert_eq!(values(&back), values(&data));
    }
}
