//! AdamW with clipping by the global norm, over plain tensors so that all its state can be saved.
//! Independent of models and schedules.
//!
//! Parameters with the same rules lie side by side in memory, so that a step is a few operations on each block of them and
//! not on each parameter: on a GPU every operation costs a launch, however small its tensor. On a processor a block is small
//! enough for its caches.

use std::collections::BTreeMap;

use tch::{Kind, Tensor, no_grad_guard};

use crate::batch::int;
use crate::error::LearnError;
use crate::model::IMAGES;
use gleaner_core::OptimSpec;

const BETA: [f64; 2] = [0.9, 0.999];
const EPSILON: f64 = 1e-8;
/// Values from which a block on a processor takes no further parameter: its tensors are then 256 KiB.
const CACHED: usize = 1 << 16;
/// A parameter begins at a multiple of this number of values, 64 bytes, as one with memory of its own does.
const ALIGNED: usize = 16;

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

/// Gradients side by side as their parameters are: one tensor `[N]` for each block.
pub(crate) struct Gathered(Vec<Tensor>);

/// Parameters with the same rules, each a view of a part of these tensors `[N]`.
struct Block {
    slots: Vec<usize>,
    parameter: Tensor,
    mean: Tensor,
    square: Tensor,
    decays: bool,
    of_images: bool,
}

/// The optimiser of some parameters.
pub(crate) struct AdamW {
    slots: Vec<Slot>,
    /// The parameters with a gradient.
    blocks: Vec<Block>,
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
        Self { slots, blocks: Vec::new() }
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
        let gathered = self.gather(&self.gradients());
        let Some(norm) = self.gradient_norm(&gathered, spec) else { return 0.0 };
        let read = norm.double_value(&[]);
        if read.is_finite() {
            self.apply(&gathered, step, rate, &norm, spec);
        }
        read
    }

    /// Lays `gradients` side by side, and the parameters that have one.
    pub(crate) fn gather(&mut self, gradients: &Gradients) -> Gathered {
        let _no_grad = no_grad_guard();
        let present: Vec<usize> = (0..self.slots.len()).filter(|at| gradients[*at].is_some()).collect();
        let mut laid: Vec<usize> = self.blocks.iter().flat_map(|block| block.slots.iter().copied()).collect();
        laid.sort_unstable();
        if present != laid {
            self.lay_out(&present);
        }
        let of_block = |block: &Block| beside(block.slots.iter().filter_map(|at| gradients[*at].as_ref()));
        Gathered(self.blocks.iter().map(of_block).collect())
    }

    /// Moves these parameters and their state into blocks.
    fn lay_out(&mut self, present: &[usize]) {
        self.blocks.clear();
        for (decays, of_images) in [(false, false), (false, true), (true, false), (true, true)] {
            let alike = |at: &&usize| (self.slots[**at].decays, self.slots[**at].of_images) == (decays, of_images);
            let slots: Vec<usize> = present.iter().filter(alike).copied().collect();
            for slots in self.parts(&slots) {
                let block = self.block(slots, decays, of_images);
                self.blocks.push(block);
            }
        }
    }

    /// These parameters in parts, each for a block.
    fn parts(&self, slots: &[usize]) -> Vec<Vec<usize>> {
        let mut parts: Vec<Vec<usize>> = Vec::new();
        let mut values = 0;
        for at in slots {
            let parameter = &self.slots[*at].parameter;
            match parts.last_mut().filter(|_| values < CACHED || parameter.device().is_cuda()) {
                Some(part) => part.push(*at),
                None => {
                    parts.push(vec![*at]);
                    values = 0;
                }
            }
            values += parameter.numel();
        }
        parts
    }

    /// Moves these parameters and their state into a block.
    fn block(&mut self, slots: Vec<usize>, decays: bool, of_images: bool) -> Block {
        let joined = |part: fn(&Slot) -> &Tensor| beside(slots.iter().map(|at| part(&self.slots[*at])));
        let [parameter, mean, square] =
            [joined(|slot| &slot.parameter), joined(|slot| &slot.mean), joined(|slot| &slot.square)];
        let mut begin = 0;
        for at in &slots {
            let slot = &mut self.slots[*at];
            let (count, size) = (slot.parameter.numel(), slot.parameter.size());
            let view = |of: &Tensor| of.narrow(0, begin, int(count)).view(size.as_slice());
            slot.parameter.set_data(&view(&parameter));
            (slot.mean, slot.square) = (view(&mean), view(&square));
            begin += int(count.next_multiple_of(ALIGNED));
        }
        Block { slots, parameter, mean, square, decays, of_images }
    }

    /// Moves the parameters by gathered gradients, whose norm is `norm`, as step number `step` (from 0) at `rate`, those
    /// of an image encoder at `image_rate_factor` times it. Reads nothing from the device.
    pub(crate) fn apply(&mut self, gathered: &Gathered, step: u64, rate: f64, norm: &Tensor, spec: &OptimSpec) {
        let _no_grad = no_grad_guard();
        let scale =
            (norm.clamp_min(f64::MIN_POSITIVE).reciprocal() * spec.clip_norm).clamp_max(1.0).to_kind(Kind::Float);
        let count = i32::try_from(step + 1).unwrap_or(i32::MAX);
        let [first, second] = BETA.map(|beta| 1.0 - beta.powi(count));
        let of_images = rate * spec.image_rate_factor;
        for (block, gradient) in self.blocks.iter_mut().zip(&gathered.0) {
            if block.of_images && spec.image_rate_factor == 0.0 {
                continue;
            }
            let rate = if block.of_images { of_images } else { rate };
            let gradient = gradient * &scale;
            let _ = block.mean.g_mul_scalar_(BETA[0]);
            let _ = block.mean.g_add_(&(&gradient * (1.0 - BETA[0])));
            let _ = block.square.g_mul_scalar_(BETA[1]);
            let _ = block.square.g_add_(&(gradient.square() * (1.0 - BETA[1])));
            if block.decays {
                let _ = block.parameter.g_mul_scalar_(1.0 - rate * spec.weight_decay);
            }
            let spread = (&block.square / second).sqrt() + EPSILON;
            let _ = block.parameter.g_sub_(&(&block.mean * (rate / first) / spread));
        }
    }

    /// The global norm of gathered gradients, a scalar of doubles on the parameters' device, without the parameters of a
    /// frozen image encoder; `None` if no parameter has a gradient.
    pub(crate) fn gradient_norm(&self, gathered: &Gathered, spec: &OptimSpec) -> Option<Tensor> {
        let _no_grad = no_grad_guard();
        let with_images = spec.image_rate_factor > 0.0;
        let counted = self.blocks.iter().zip(&gathered.0).filter(|(block, _)| with_images || !block.of_images);
        let squares: Vec<Tensor> = counted.map(|(_, gradient)| gradient.square().sum(Kind::Double)).collect();
        (!squares.is_empty()).then(|| Tensor::stack(&squares, 0).sum(Kind::Double).sqrt())
    }
}

/// Tensors of any size side by side, each at a multiple of [`ALIGNED`] values; zeros fill the gaps. A tensor alone is not
/// copied.
fn beside<'a>(tensors: impl Iterator<Item = &'a Tensor>) -> Tensor {
    let mut parts = Vec::new();
    for tensor in tensors {
        let (flat, count) = (tensor.detach().flatten(0, -1), tensor.numel());
        let gap = int(count.next_multiple_of(ALIGNED) - count);
        if gap > 0 {
            let gap = Tensor::zeros([gap], (flat.kind(), flat.device()));
            parts.extend([flat, gap]);
        } else {
            parts.push(flat);
        }
    }
    match parts.as_slice() {
        [alone] => alone.shallow_clone(),
        several => Tensor::cat(several, 0),
    }
}

#[cfg(test)]
mod tests;
