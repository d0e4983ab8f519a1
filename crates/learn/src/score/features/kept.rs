//! Features as bytes for a store, so that a later run of the same encoder does not encode again. Independent of files.

use std::collections::HashMap;

use gleaner_search::PointShape;
use safetensors::tensor::{Dtype, TensorView};
use safetensors::{SafeTensors, serialize};

use super::Features;
use super::rough::{Codes, Rough};
use crate::error::LearnError;

/// The modalities' names in the bytes.
const NAMES: [&str; 3] = ["o", "m", "a"];
/// The names of the values of a code of 1, and of the longest distances between features and their codes.
const BOUNDS: [&str; 2] = ["steps", "moved"];

/// Stores features from one run to the next. One store is for one encoder and one
/// [`features_kind`](crate::features_kind). Features are read and stored by several threads.
pub trait FeatureStore: Sync {
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

/// Kept features.
pub(in crate::score) enum Kept {
    Exact(Features),
    Rough(Rough),
}

/// The features as bytes, exactly: four bytes a value.
///
/// # Errors
/// [`LearnError::Checkpoint`] when they do not fit the format, which does not happen.
pub(in crate::score) fn exact_bytes(features: &Features) -> Result<Vec<u8>, LearnError> {
    let bytes = [0, 1, 2].map(|i| little_endian(features.values(i)));
    let views = NAMES.iter().zip(&bytes).zip(features.shape().widths).enumerate().map(|(i, ((name, bytes), width))| {
        let rows = features.values(i).len() / width.max(1);
        Ok((*name, TensorView::new(Dtype::F32, vec![rows, width], bytes)?))
    });
    Ok(serialize(views.collect::<Result<Vec<_>, LearnError>>()?, None::<HashMap<String, String>>)?)
}

/// The features, of one row each, as bytes, rounded: one byte a value.
///
/// # Errors
/// As [`exact_bytes`]; [`LearnError::Invalid`] for features of several rows.
pub(in crate::score) fn rough_bytes(features: &Features) -> Result<Vec<u8>, LearnError> {
    if features.shape().length > 1 {
        return Err(LearnError::invalid("features", "are of several rows; keep them as they are"));
    }
    let Codes { codes, steps, moved } = Codes::of(features);
    let bytes = codes.map(|codes| codes.iter().map(|code| code.to_le_bytes()[0]).collect::<Vec<u8>>());
    let bounds = [little_endian(&steps), little_endian(&moved)];
    let mut views = Vec::new();
    for ((name, bytes), width) in NAMES.iter().zip(&bytes).zip(features.widths()) {
        views.push((*name, TensorView::new(Dtype::I8, vec![features.count(), width], bytes)?));
    }
    for (name, bytes) in BOUNDS.iter().zip(&bounds) {
        views.push((*name, TensorView::new(Dtype::F32, vec![3], bytes)?));
    }
    Ok(serialize(views, None::<HashMap<String, String>>)?)
}

/// The features in the result of [`exact_bytes`] or [`rough_bytes`]; `None` unless they are `count` comparable points, in
/// sequence, of this shape.
pub(in crate::score) fn from_bytes(bytes: &[u8], count: usize, shape: PointShape) -> Option<Kept> {
    let (rows, widths) = (count + shape.length - 1, shape.widths);
    let tensors = SafeTensors::deserialize(bytes).ok()?;
    let data = |name: &str, kind: Dtype, shape: &[usize]| {
        let view = tensors.tensor(name).ok()?;
        (view.dtype() == kind && view.shape() == shape).then(|| view.data().to_vec())
    };
    let parts = |kind: Dtype| -> Option<Vec<Vec<u8>>> {
        NAMES.iter().zip(widths).map(|(name, width)| data(name, kind, &[rows, width])).collect()
    };
    if let Some(values) = parts(Dtype::F32) {
        let values: Vec<Vec<f32>> = values.iter().map(|bytes| floats(bytes)).collect();
        return Features::new(values.try_into().ok()?, shape).ok().map(Kept::Exact);
    }
    let codes =
        parts(Dtype::I8)?.into_iter().map(|bytes| bytes.into_iter().map(|byte| i8::from_le_bytes([byte])).collect());
    let codes: [Vec<i8>; 3] = codes.collect::<Vec<_>>().try_into().ok()?;
    let bound = |name| -> Option<[f32; 3]> { floats(&data(name, Dtype::F32, &[3])?).try_into().ok() };
    let codes = Codes { codes, steps: bound(BOUNDS[0])?, moved: bound(BOUNDS[1])? };
    codes.rough(count, widths).map(Kept::Rough)
}

fn little_endian(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}

fn floats(bytes: &[u8]) -> Vec<f32> {
    bytes.as_chunks::<4>().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn exact(kept: Option<Kept>) -> Option<Features> {
        kept.and_then(|kept| if let Kept::Exact(features) = kept { Some(features) } else { None })
    }

    #[test]
    fn bytes_give_the_features_back_and_others_nothing() {
        let values = [vec![1.0, -0.0, 1e-40, 3.5], vec![2.0, f32::MIN_POSITIVE], vec![0.1, 0.2, 0.3, 0.4, 0.5, 0.6]];
        let features = Features::new(values, [2, 1, 3]).unwrap();
        let bytes = exact_bytes(&features).unwrap();
        let read = exact(from_bytes(&bytes, 2, [2, 1, 3].into())).unwrap();
        let bits =
            |features: &Features| (0..3).flat_map(|i| features.values(i)).map(|x| x.to_bits()).collect::<Vec<u32>>();
        assert_eq!((bits(&read), read.widths()), (bits(&features), features.widths()));
        let rough = rough_bytes(&features).unwrap();
        for bytes in [&bytes, &rough] {
            for (count, widths) in [(1, [2, 1, 3]), (2, [2, 3, 1]), (2, [4, 2, 6]), (3, [2, 1, 3])] {
                assert!(from_bytes(bytes, count, widths.into()).is_none(), "{count} {widths:?}");
            }
            assert!(from_bytes(&bytes[..bytes.len() - 1], 2, [2, 1, 3].into()).is_none());
        }
        let windows =
            Features::new([vec![0.5; 6], vec![0.5; 3], vec![0.5; 3]], PointShape { widths: [2, 1, 1], length: 2 });
        let windows = windows.unwrap();
        let read = exact(from_bytes(&exact_bytes(&windows).unwrap(), 2, windows.shape()));
        assert_eq!(read.as_ref(), Some(&windows));
        assert!(rough_bytes(&windows).is_err());
        assert!(from_bytes(b"features", 2, [2, 1, 3].into()).is_none());
        let mut unsound = Features::empty([1; 3]);
        unsound.extend([[f32::NAN], [0.0], [0.0]]);
        assert!(from_bytes(&exact_bytes(&unsound).unwrap(), 1, [1; 3].into()).is_none());
    }

    #[test]
    fn rough_features_take_a_byte_a_value() {
        let values = [vec![1.0, -2.54, 0.5, 3.0], vec![2.0, 0.3], vec![0.1, 0.2, 0.3, 0.4, 0.5, 0.6]];
        let features = Features::new(values, [2, 1, 3]).unwrap();
        let bytes = rough_bytes(&features).unwrap();
        let Some(Kept::Rough(rough)) = from_bytes(&bytes, 2, [2, 1, 3].into()) else { panic!("not rough") };
        for part in 0..3 {
            for (found, exact) in rough.points().values(part).iter().zip(features.values(part)) {
                assert!((found - exact).abs() <= 3.0 / 127.0 / 2.0, "{found} for {exact}");
            }
        }
        let many = Features::new([vec![0.5; 128_000], vec![0.5; 128_000], vec![0.5; 128_000]], [128; 3]).unwrap();
        let (rough, exact) = (rough_bytes(&many).unwrap().len(), exact_bytes(&many).unwrap().len());
        assert!(rough * 4 < exact + 2000, "{rough} of {exact}");
    }
}
