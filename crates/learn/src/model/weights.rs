//! Initial weights from this crate's own random numbers, and weights from a checkpoint.
//!
//! The library's initialisers draw from a process-wide generator; a run must depend on its seed alone, so every
//! parameter is drawn again here.

use std::collections::BTreeMap;

use rand::RngExt;
use tch::{Tensor, nn, no_grad_guard};

use crate::error::LearnError;
use crate::model::image_encoder::RESNET;
use crate::random::{Purpose, generator};

/// Initial standard deviation of embeddings.
const EMBEDDING: f64 = 0.1;

/// The end of the name of kernels that find keypoints.
const KEYPOINTS: &str = ".keypoint.weight";

/// Every parameter in name order.
pub(crate) fn sorted(store: &nn::VarStore) -> Vec<(String, Tensor)> {
    let sorted: BTreeMap<_, _> = store.variables().into_iter().collect();
    sorted.into_iter().collect()
}

/// Draws `parameters`, given in name order: matrices and kernels uniform with variance `1 / inputs` (kernels, which a
/// ReLU follows, `2 / inputs`), embeddings uniform with a fixed deviation, norms 1, biases 0. The kernels that find
/// keypoints are `keypoint_gain` times as large. A frozen norm is the identity, until given weights replace it.
pub(crate) fn draw(parameters: &[(String, Tensor)], keypoint_gain: f64, seed: u64) {
    let _no_grad = no_grad_guard();
    for (place, (name, parameter)) in (0u64..).zip(parameters) {
        let mut parameter = parameter.shallow_clone();
        let size = parameter.size();
        if name.ends_with("bias") || name.ends_with("running_mean") {
            let _ = parameter.zero_();
        } else if size.len() == 1 {
            let _ = parameter.fill_(1.0);
        } else {
            let gain = if name.ends_with(KEYPOINTS) { keypoint_gain } else { 1.0 };
            let deviation = gain * deviation(name, &size);
            fill_uniform(&mut parameter, deviation, seed, place);
        }
    }
}

fn deviation(name: &str, size: &[i64]) -> f64 {
    if name.ends_with("embedding") {
        return EMBEDDING;
    }
    #[expect(clippy::cast_precision_loss, reason = "layer sizes are far below 2^52")]
    let inputs = size[1..].iter().product::<i64>() as f64;
    let gain: f64 = if size.len() == 4 { 2.0 } else { 1.0 };
    (gain / inputs).sqrt()
}

fn fill_uniform(parameter: &mut Tensor, deviation: f64, seed: u64, place: u64) {
    let mut rng = generator(seed, Purpose::Weights, place);
    let bound = deviation * 3f64.sqrt();
    let values: Vec<f64> = (0..parameter.numel()).map(|_| rng.random_range(-bound..bound)).collect();
    let values = Tensor::from_slice(&values).view(parameter.size().as_slice());
    parameter.copy_(&values);
}

/// Copies `named` into `parameters`.
pub(crate) fn load(parameters: &[(String, Tensor)], named: &BTreeMap<String, Tensor>) -> Result<(), LearnError> {
    blend(parameters, named, 0.0)
}

/// Replaces all but a share f of each parameter: w ← f w + (1 − f) w′, with w′ in `named`. A ResNet is copied whole,
/// because the statistics of its norms are fixed.
pub(crate) fn blend(
    parameters: &[(String, Tensor)],
    named: &BTreeMap<String, Tensor>,
    share: f64,
) -> Result<(), LearnError> {
    let _no_grad = no_grad_guard();
    for (name, parameter) in parameters {
        let stored = named.get(name).filter(|stored| stored.size() == parameter.size());
        let Some(stored) = stored else {
            let size = parameter.size();
            return Err(LearnError::Checkpoint(format!("`{name}` is missing or does not have size {size:?}")));
        };
        let mut parameter = parameter.shallow_clone();
        if share == 0.0 || name.split('.').any(|part| part == RESNET) {
            parameter.copy_(stored);
        } else {
            let _ = parameter.lerp_(stored, 1.0 - share);
        }
    }
    Ok(())
}
