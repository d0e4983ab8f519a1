//! AdamW with clipping by the global norm, over plain tensors so that all its state can be saved.
//! Independent of models and schedules.

use std::collections::BTreeMap;

use tch::{Kind, Tensor, no_grad_guard};

use crate::error::LearnError;
use crate::model::IMAGES;
use gleaner_core::OptimSpec;

const BETA: [f64; 2] = [0.9, 0.999];
const EPSILON: f64 = 1e-8;

struct Slot {
    name: String,
    parameter: Tensor,
    /// Running mean of the gradient.
    mean: Tensor,
    /// Running mean of its square.
    square: Tensor,
    decays: bool,
    /// Whether it is of an image encoder, which has a rate of its own.
    of_images: bool,
}

/// The gradient of each parameter, in the optimiser's order; `None` for one that the loss does not depend on.
pub(crate) type Gradients = Vec<Option<Tensor>>;

/// The optimiser of some parameters.
pub(crate) struct AdamW {
    slots: Vec<Slot>,
}

impl AdamW {
    /// An optimiser of `parameters`, without history.
    pub(crate) fn new(parameters: Vec<(String, Tensor)>) -> Self {
        let slots = parameters
            .into_iter()
            .map(|(name, parameter)| Slot {
                mean: parameter.detach().zeros_like(),
                square: parameter.detach().zeros_like(),
                decays: parameter.dim() > 1 && !name.ends_with("embedding"),
                of_images: name.split('.').nth(1) == Some(IMAGES),
                name,
                parameter,
            })
            .collect();
        Self { slots }
    }

    /// The state with its names in a checkpoint.
    pub(crate) fn named(&self) -> Vec<(String, Tensor)> {
        let slots = self.slots.iter();
        slots
            .flat_map(|slot| {
                [
                    (format!("optimizer.mean.{}", slot.name), slot.mean.shallow_clone()),
                    (format!("optimizer.square.{}", slot.name), slot.square.shallow_clone()),
                ]
            })
            .collect()
    }

    /// Takes the state from `named`.
    pub(crate) fn load(&mut self, named: &BTreeMap<String, Tensor>) -> Result<(), LearnError> {
        for slot in &mut self.slots {
            for (part, tensor) in [("mean", &mut slot.mean), ("square", &mut slot.square)] {
                let name = format!("optimizer.{part}.{}", slot.name);
                match named.get(&name) {
                    Some(stored) if stored.size() == tensor.size() => tensor.copy_(stored),
                    _ => {
                        return Err(LearnError::Checkpoint(format!(
                            "`{name}` is missing; only an unfinished run's checkpoint resumes"
                        )));
                    }
                }
            }
        }
        Ok(())
    }

    /// Clears all gradients.
    pub(crate) fn zero_grad(&mut self) {
        for slot in &mut self.slots {
            slot.parameter.zero_grad();
        }
    }

    /// Every parameter, in the order of [`Gradients`].
    pub(crate) fn parameters(&self) -> impl Iterator<Item = &Tensor> + Clone {
        self.slots.iter().map(|slot| &slot.parameter)
    }

    /// The gradients of the parameters.
    pub(crate) fn gradients(&self) -> Gradients {
        self.parameters().map(|parameter| Some(parameter.grad()).filter(Tensor::defined)).collect()
    }

    /// Moves the parameters by their gradients as [`AdamW::apply`] does. Returns the global gradient norm before
    /// clipping; parameters stay unchanged if it is not finite.
    pub(crate) fn step(&mut self, step: u64, rate: f64, spec: &OptimSpec) -> f64 {
        let gradients = self.gradients();
        let norm = self.gradient_norm(&gradients, spec).map_or(0.0, |norm| norm.double_value(&[]));
        if norm.is_finite() {
            self.apply(&gradients, step, rate, norm, spec);
        }
        norm
    }

    /// Moves the parameters by `gradients`, whose norm is `norm`, as step number `step` (from 0) at `rate`, those
    /// of an image encoder at `image_rate_factor` times it.
    pub(crate) fn apply(&mut self, gradients: &Gradients, step: u64, rate: f64, norm: f64, spec: &OptimSpec) {
        let _no_grad = no_grad_guard();
        let scale = (spec.clip_norm / norm.max(f64::MIN_POSITIVE)).min(1.0);
        let count = i32::try_from(step + 1).unwrap_or(i32::MAX);
        let [first, second] = BETA.map(|beta| 1.0 - beta.powi(count));
        let of_images = rate * spec.image_rate_factor;
        for (slot, gradient) in self.slots.iter_mut().zip(gradients) {
            if slot.of_images && spec.image_rate_factor == 0.0 {
                continue;
            }
            let rate = if slot.of_images { of_images } else { rate };
            let Some(gradient) = gradient else { continue };
            let gradient = gradient * scale;
            let _ = slot.mean.g_mul_scalar_(BETA[0]);
            let _ = slot.mean.g_add_(&(&gradient * (1.0 - BETA[0])));
            let _ = slot.square.g_mul_scalar_(BETA[1]);
            let _ = slot.square.g_add_(&(gradient.square() * (1.0 - BETA[1])));
            if slot.decays {
                let _ = slot.parameter.g_mul_scalar_(1.0 - rate * spec.weight_decay);
            }
            let spread = (&slot.square / second).sqrt() + EPSILON;
            let _ = slot.parameter.g_sub_(&(&slot.mean * (rate / first) / spread));
        }
    }

    /// The global norm of `gradients`, a scalar of doubles on the parameters' device, without the parameters of a frozen image
    /// encoder; `None` if no parameter has a gradient.
    pub(crate) fn gradient_norm(&self, gradients: &Gradients, spec: &OptimSpec) -> Option<Tensor> {
        let _no_grad = no_grad_guard();
        let with_images = spec.image_rate_factor > 0.0;
        let squares: Vec<Tensor> = self
            .slots
            .iter()
            .zip(gradients)
            .filter(|(slot, _)| with_images || !slot.of_images)
            .filter_map(|(_, gradient)| gradient.as_ref())
            .map(|gradient| gradient.square().sum(Kind::Double))
            .collect();
        (!squares.is_empty()).then(|| Tensor::stack(&squares, 0).sum(Kind::Double).sqrt())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::batch::values;

    fn spec(weight_decay: f64, clip_norm: f64) -> OptimSpec {
        OptimSpec { weight_decay, clip_norm, ..OptimSpec::default() }
    }

    /// Steps `[x]` under the loss `slope * x`.
    fn run(spec: &OptimSpec, slope: f64, steps: u64) -> (f32, f64) {
        let x = Tensor::from_slice(&[1.0f32]).view([1, 1]).set_requires_grad(true);
        let mut adam = AdamW::new(vec![("x".into(), x.shallow_clone())]);
        let mut norm = 0.0;
        for step in 0..steps {
            adam.zero_grad();
            (&x * slope).sum(Kind::Float).backward();
            norm = adam.step(step, 0.1, spec);
        }
        (values(&x)[0], norm)
    }

    #[test]
    fn the_first_steps_are_those_of_the_formula() {
        // A constant gradient makes mean / sqrt(square) exactly 1 after bias correction.
        let (x, norm) = run(&spec(0.0, 100.0), 3.0, 2);
        assert!((f64::from(x) - 0.8).abs() < 1e-6, "{x}");
        assert!((norm - 3.0).abs() < 1e-12);
        let (x, _) = run(&spec(0.5, 100.0), 3.0, 1);
        assert!((f64::from(x) - (1.0 - 0.1 * 0.5 - 0.1)).abs() < 1e-6, "{x}");
    }

    #[test]
    fn the_image_encoder_has_a_rate_of_its_own() {
        let parameter = |name: &str| {
            (name.to_owned(), Tensor::ones([1, 1], (Kind::Float, tch::Device::Cpu)).set_requires_grad(true))
        };
        let parameters = ["model.head.image.out.weight", "model.image.project.weight"].map(parameter);
        let mut adam = AdamW::new(parameters.iter().map(|(name, x)| (name.clone(), x.shallow_clone())).collect());
        parameters.iter().map(|(_, x)| x).sum::<Tensor>().backward();
        let norm = adam.step(0, 0.1, &OptimSpec { image_rate_factor: 0.0, ..spec(0.5, 100.0) });
        let after = parameters.map(|(_, x)| values(&x)[0]);
        assert!((after[0] - 0.85).abs() < 1e-6, "{after:?}");
        assert_eq!(after[1], 1.0, "neither moved nor decayed");
        assert!((norm - 1.0).abs() < 1e-9, "a frozen part does not count: {norm}");
    }

    #[test]
    fn the_norm_reported_is_the_one_before_clipping_and_nothing_moves_on_nan() {
        assert!((run(&spec(0.0, 1.0), 1e6, 1).1 - 1e6).abs() < 1.0);
        let (x, norm) = run(&spec(0.0, 1.0), f64::NAN, 1);
        assert!(norm.is_nan() && x == 1.0);
    }
}
