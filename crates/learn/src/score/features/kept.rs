//! Features as bytes for a store, so that a later run of the same encoder does not encode again. Independent of files.

use std::collections::HashMap;

use safetensors::tensor::{Dtype, TensorView};
use safetensors::{SafeTensors, serialize};

use super::Features;
use crate::error::LearnError;

/// The modalities' names in the bytes.
const NAMES: [&str; 3] = ["o", "m", "a"];

/// Stores features from one run to the next. One store is for one encoder and one
/// [`features_kind`](crate::features_kind).
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
}
