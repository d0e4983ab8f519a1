//! Features as bytes for a store, so that a later run of the same encoder does not encode again. Independent of files.

use std::collections::HashMap;

use safetensors::tensor::{Dtype, TensorView};
use safetensors::{SafeTensors, serialize};

use super::Features;
use crate::error::LearnError;
use crate::score::comparison::{Comparison, Source};
use crate::score::scorer;
use gleaner_core::{Device, ScoreSpec, Words as _};

/// To be raised with every change of this program or of libtorch that changes the features of the same encoder, episode
/// and settings.
const VERSION: u32 = 1;
/// The modalities' names in the bytes.
const NAMES: [&str; 3] = ["o", "m", "a"];

/// Stores features from one run to the next. One store is for one encoder and one [`features_kind`].
pub trait FeatureStore {
    /// The stored bytes for the episode of this id; `None` without any. Bytes that cannot be its features are ignored.
    fn get(&self, episode: &str) -> Option<Vec<u8>>;

    /// Stores the features of the episode of this id. An implementation may skip this, because features can be computed
    /// again.
    fn put(&self, episode: &str, bytes: &[u8]);
}

/// A store that is always empty.
#[derive(Debug, Clone, Copy, Default)]
pub struct Forgetful;

impl FeatureStore for Forgetful {
    fn get(&self, _: &str) -> Option<Vec<u8>> {
        None
    }

    fn put(&self, _: &str, _: &[u8]) {}
}

/// The values that, besides the encoder and the episode, decide a segment's features to the last bit; `None` where
/// storing features costs no less than computing them.
///
/// # Errors
/// [`LearnError::Invalid`] for a scorer that this program does not have.
pub fn features_kind(spec: &ScoreSpec) -> Result<Option<String>, LearnError> {
    // All fields, so that a new one is not overlooked; features do not depend on the comparison.
    let ScoreSpec { scorer, normaliser: _, device, threads } = spec;
    let scorer = scorer::open(scorer)?;
    let Some(Comparison { source: Source::Features(scale), similarity, local_scale: _, scale: _ }) =
        scorer.comparison()
    else {
        return Ok(None);
    };
    let steps = if similarity.whole_segment() { "segment" } else { "last" };
    let device = match device {
        Device::Cpu => processor(),
        Device::Cuda => "cuda",
    };
    let threads = threads.unwrap_or_default();
    Ok(Some(format!("{VERSION} {} {steps} {device} {threads}", scale.as_str())))
}

/// The processor features by which libtorch chooses its kernels, whose rounding differs.
fn processor() -> &'static str {
    #[cfg(target_arch = "x86_64")]
    if std::is_x86_feature_detected!("avx512f") {
        return "cpu avx512";
    } else if std::is_x86_feature_detected!("avx2") {
        return "cpu avx2";
    }
    "cpu"
}

/// The features as bytes.
///
/// # Errors
/// [`LearnError::Checkpoint`] when they do not fit the format, which does not happen.
pub(in crate::score) fn to_bytes(features: &Features) -> Result<Vec<u8>, LearnError> {
    let bytes = [0, 1, 2].map(|i| features.values(i).iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>());
    let views =
        NAMES.iter().zip(&bytes).zip(features.widths()).map(|((name, bytes), width)| {
            Ok((*name, TensorView::new(Dtype::F32, vec![features.count(), width], bytes)?))
        });
    Ok(serialize(views.collect::<Result<Vec<_>, LearnError>>()?, None::<HashMap<String, String>>)?)
}

/// The features in the result of [`to_bytes`]; `None` unless they are `count` comparable rows of these widths.
pub(in crate::score) fn from_bytes(bytes: &[u8], count: usize, widths: [usize; 3]) -> Option<Features> {
    let tensors = SafeTensors::deserialize(bytes).ok()?;
    let mut values: [Vec<f32>; 3] = Default::default();
    for ((name, width), values) in NAMES.iter().zip(widths).zip(&mut values) {
        let view = tensors.tensor(name).ok()?;
        if view.dtype() != Dtype::F32 || view.shape() != [count, width] {
            return None;
        }
        let (floats, _) = view.data().as_chunks::<4>();
        *values = floats.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect();
    }
    Features::new(values, widths).ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::score::tests::spec_of;

    #[test]
    fn bytes_give_the_features_back_and_others_nothing() {
        let values = [vec![1.0, -0.0, 1e-40, 3.5], vec![2.0, f32::MIN_POSITIVE], vec![0.1, 0.2, 0.3, 0.4, 0.5, 0.6]];
        let features = Features::new(values, [2, 1, 3]).unwrap();
        let bytes = to_bytes(&features).unwrap();
        let read = from_bytes(&bytes, 2, [2, 1, 3]).unwrap();
        let bits =
            |features: &Features| (0..3).flat_map(|i| features.values(i)).map(|x| x.to_bits()).collect::<Vec<u32>>();
        assert_eq!((bits(&read), read.widths()), (bits(&features), features.widths()));
        for (count, widths) in [(1, [2, 1, 3]), (2, [2, 3, 1]), (2, [4, 2, 6]), (3, [2, 1, 3])] {
            assert!(from_bytes(&bytes, count, widths).is_none(), "{count} {widths:?}");
        }
        assert!(from_bytes(&bytes[..bytes.len() - 1], 2, [2, 1, 3]).is_none());
        assert!(from_bytes(b"features", 2, [2, 1, 3]).is_none());
        let mut unsound = Features::empty([1; 3]);
        unsound.extend([[f32::NAN], [0.0], [0.0]]);
        assert!(from_bytes(&to_bytes(&unsound).unwrap(), 1, [1; 3]).is_none());
    }

    #[test]
    fn whatever_changes_features_is_another_kind() {
        let kind = |spec: ScoreSpec| features_kind(&spec).unwrap();
        let usual = kind(ScoreSpec::default()).unwrap();
        for other in [
            spec_of("ssdf", &[("similarity", "segment_l2".into())]),
            spec_of("ssdf", &[("feature_scale", "plain".into())]),
            ScoreSpec { device: Device::Cuda, ..ScoreSpec::default() },
            ScoreSpec { threads: Some(2), ..ScoreSpec::default() },
        ] {
            assert_ne!(kind(other.clone()).unwrap(), usual, "{other:?}");
        }
        let compared_otherwise =
            spec_of("ssdf", &[("similarity", "last_cosine".into()), ("scale", vec![1.0, 2.0, 3.0].into())]);
        assert_eq!(kind(compared_otherwise).unwrap(), usual);
        assert_eq!(kind(spec_of("raw", &[])), None);
    }
}
