//! Weights made by a formula, in the form that torchvision's have, for tests. `resnet/reference.py` has the same
//! formula.

#![allow(clippy::cast_precision_loss)]

use std::collections::BTreeMap;

use gleaner_core::{ImageEncoder as Kind, ModelSpec};
use safetensors::serialize;
use safetensors::tensor::{Dtype, TensorView};
use tch::{Device, nn};

use crate::model::image_encoder::{ImageEncoder, RESNET};
use crate::model::weights;
use crate::shape::{CameraShape, TaskShape};

/// A file's tensors: sizes and values by name.
pub(crate) type Tensors = BTreeMap<String, (Vec<usize>, Vec<f32>)>;

/// `count` numbers in 0 … 1.
pub(crate) fn uniform(name: &str, count: usize) -> impl Iterator<Item = f64> {
    let start = name.bytes().map(u32::from).sum::<u32>().wrapping_mul(97);
    (0..u32::try_from(count).unwrap()).map(move |place| {
        let mut x = place.wrapping_mul(2_654_435_761).wrapping_add(start);
        x = (x ^ (x >> 15)).wrapping_mul(2_246_822_519);
        f64::from(x ^ (x >> 13)) / 4_294_967_296.0
    })
}

/// The smallest and the largest value of a tensor.
fn bounds(name: &str, size: &[usize]) -> [f64; 2] {
    if let [_, inputs, height, width] = size {
        let bound = (6.0 / (inputs * height * width) as f64).sqrt();
        return [-bound, bound];
    }
    if name.ends_with(".weight") || name.ends_with(".running_var") { [0.5, 1.5] } else { [-0.2, 0.2] }
}

/// Every tensor of a ResNet, without the classifier.
pub(crate) fn tensors(image_encoder: Kind) -> Tensors {
    let shape = TaskShape {
        cameras: vec![CameraShape { name: "c".into(), height: 32, width: 32, depth: false, recorded: None }],
        proprioception: 1,
        action: 1,
        ranges: gleaner_core::action::ActionRanges::default(),
    };
    let store = nn::VarStore::new(Device::Cpu);
    let _ = ImageEncoder::new(&store.root(), &shape, &ModelSpec { image_encoder, ..ModelSpec::default() });
    let mut tensors = Tensors::new();
    for (name, parameter) in weights::sorted(&store) {
        let Some((_, name)) = name.split_once(&format!(".{RESNET}.")) else { continue };
        let size: Vec<usize> = parameter.size().into_iter().map(|side| usize::try_from(side).unwrap()).collect();
        let [low, high] = bounds(name, &size);
        #[expect(clippy::cast_possible_truncation, reason = "the file holds floats")]
        let values = uniform(name, size.iter().product()).map(|u| (low + (high - low) * u) as f32).collect();
        tensors.insert(name.to_owned(), (size, values));
    }
    tensors
}

/// A safetensors file of these tensors.
pub(crate) fn file(tensors: &Tensors) -> Vec<u8> {
    let bytes = |values: &[f32]| values.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>();
    let stored: Vec<_> = tensors.iter().map(|(name, (size, values))| (name, size, bytes(values))).collect();
    let views = stored
        .iter()
        .map(|(name, size, bytes)| (name.as_str(), TensorView::new(Dtype::F32, (*size).clone(), bytes).unwrap()));
    serialize(views, None).unwrap()
}
