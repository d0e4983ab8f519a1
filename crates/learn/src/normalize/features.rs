//! The scale of features: their mean and covariance over D_u, measured once at the end of
//! pretraining and kept with the encoder. Independent of the comparison of features.

use std::collections::BTreeMap;

use tch::{Device, Kind, Tensor};

use crate::batch::int;
use crate::error::LearnError;

/// Names of the modalities in a checkpoint.
const MODALITIES: [&str; 3] = ["image", "proprioception", "action"];
/// Directions whose variance is below this part of the largest variance are noise and are not amplified to the size of
/// the others.
const NOISE: f64 = 1e-3;

/// Whitening of z^o, z^m and z^a: (z − μ) U (Λ + ε λ_max)^(−1/2), with Σ = U Λ Uᵀ the covariance.
///
/// A feature's few widest directions encode the position of the arm and the scene; the effect of an action on them is a
/// narrow one. Under the plain L2 distance the wide directions outweigh the narrow ones.
pub(crate) struct FeatureScale {
    /// Per modality `[d]`.
    mean: [Tensor; 3],
    /// Per modality `[d, d]`.
    matrix: [Tensor; 3],
}

impl FeatureScale {
    /// Measures features, per modality `[N, d]`.
    pub(crate) fn measure(features: [&Tensor; 3]) -> Self {
        let mean = features.map(|z| z.to_kind(Kind::Double).mean_dim([0i64].as_slice(), false, Kind::Double));
        let whitening = |i: usize| {
            let z = features[i].to_kind(Kind::Double) - &mean[i];
            let covariance = z.tr().matmul(&z) / f64::from(u32::try_from(z.size()[0]).unwrap_or(u32::MAX)).max(1.0);
            let (variances, directions) = covariance.linalg_eigh("L");
            let floor = (variances.max() * NOISE).clamp_min(1e-12);
            (directions / (variances.clamp_min(0.0) + floor).sqrt()).to_kind(Kind::Float)
        };
        Self { matrix: [0, 1, 2].map(whitening), mean: mean.map(|mean| mean.to_kind(Kind::Float)) }
    }

    /// Whitens the features of a `modality` (0 for o, 1 for m, 2 for a), `[…, d]`.
    pub(crate) fn apply(&self, modality: usize, z: &Tensor) -> Tensor {
        (z - &self.mean[modality]).matmul(&self.matrix[modality])
    }

    /// Every tensor with its name in a checkpoint.
    pub(crate) fn named(&self) -> Vec<(String, Tensor)> {
        let all = [("mean", &self.mean), ("whitening", &self.matrix)];
        let named = all.into_iter().flat_map(|(what, tensors)| {
            let of = |(modality, tensor): (&&str, &Tensor)| (name(modality, what), tensor.shallow_clone());
            MODALITIES.iter().zip(tensors).map(of).collect::<Vec<_>>()
        });
        named.collect()
    }

    /// The inverse of [`FeatureScale::named`], for features of `width` d.
    pub(crate) fn from_named(
        named: &BTreeMap<String, Tensor>,
        width: usize,
        device: Device,
    ) -> Result<Self, LearnError> {
        let take = |modality: usize, what: &str, size: &[i64]| {
            let name = name(MODALITIES[modality], what);
            match named.get(&name) {
                Some(tensor) if tensor.size() == size => Ok(tensor.to_device(device)),
                _ => Err(LearnError::Checkpoint(format!(
                    "`{name}` is missing or does not have size {size:?}; pretrain the encoder again, or score with \
                     plain features"
                ))),
            }
        };
        let d = int(width);
        let all = |what: &str, size: &[i64]| -> Result<[Tensor; 3], LearnError> {
            Ok([take(0, what, size)?, take(1, what, size)?, take(2, what, size)?])
        };
        Ok(Self { mean: all("mean", &[d])?, matrix: all("whitening", &[d, d])? })
    }
}

fn name(modality: &str, what: &str) -> String {
    format!("feature.{modality}.{what}")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `[N, 2]`: the first column varies a thousand times as much as the second, with which it is correlated.
    fn narrow() -> Tensor {
        let x = Tensor::arange(64i64, (Kind::Float, Device::Cpu)) - 7.0;
        let y = (&x * 0.7).sin() + &x * 1e-1;
        Tensor::stack(&[&x * 100.0, y], 1)
    }

    #[test]
    fn whitened_features_vary_alike_in_every_direction() {
        let z = narrow();
        let scale = FeatureScale::measure([&z, &z, &z]);
        let white = scale.apply(1, &z);
        let covariance = white.tr().matmul(&white) / 64.0;
        let off = (&covariance - Tensor::eye(2, (Kind::Float, Device::Cpu))).abs().max().double_value(&[]);
        // Not exactly one: the narrow direction is below the floor of noise.
        assert!(off < 1.0, "{off}");
        assert!(white.mean(Kind::Float).double_value(&[]).abs() < 1e-4);
        let wide = scale.apply(1, &(&z * Tensor::from_slice(&[1.0f32, 2.0]))) - &white;
        assert!(wide.abs().max().double_value(&[]) > 0.01, "what is narrow counts");
    }

    #[test]
    fn a_direction_without_variance_stays_finite() {
        let z = Tensor::zeros([5, 3], (Kind::Float, Device::Cpu)) + 4.0;
        let white = FeatureScale::measure([&z, &z, &z]).apply(0, &(&z + 1.0));
        assert_eq!(white.isfinite().all().int64_value(&[]), 1);
    }

    #[test]
    fn it_reads_back_from_a_checkpoint_and_a_missing_one_names_the_fix() {
        let z = narrow();
        let scale = FeatureScale::measure([&z, &z, &z]);
        let named: BTreeMap<_, _> = scale.named().into_iter().collect();
        let back = FeatureScale::from_named(&named, 2, Device::Cpu).unwrap();
        assert!(back.apply(2, &z).equal(&scale.apply(2, &z)));
        let error = FeatureScale::from_named(&BTreeMap::new(), 2, Device::Cpu).err().unwrap();
        assert!(error.to_string().contains("pretrain the encoder again"), "{error}");
    }
}
