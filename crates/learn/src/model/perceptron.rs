//! A perceptron with two hidden layers: plain layers and their shapes.

use tch::Tensor;
use tch::nn::{self, Module};

use crate::dropout::dropped;

/// Two hidden layers and an output.
pub(crate) struct Perceptron {
    hidden: [nn::Linear; 2],
    out: nn::Linear,
}

impl Perceptron {
    /// Width of the hidden layers of behaviour cloning, in multiples of the width d of an embedding.
    pub(crate) const WIDE: i64 = 4;

    /// Layers `hidden_0`, `hidden_1` and `out` of `path`, with hidden layers of `wide` values.
    pub(crate) fn new(path: &nn::Path<'_>, inputs: i64, wide: i64, outputs: i64) -> Self {
        let linear = |name: &str, from, to| nn::linear(path / name, from, to, Default::default());
        Self {
            hidden: [linear("hidden_0", inputs, wide), linear("hidden_1", wide, wide)],
            out: linear("out", wide, outputs),
        }
    }

    /// `[…, inputs]` to `[…, outputs]`.
    pub(crate) fn forward(&self, input: &Tensor) -> Tensor {
        let hidden = self.hidden.iter().fold(input.shallow_clone(), |x, layer| dropped(layer.forward(&x).gelu("none")));
        self.out.forward(&hidden)
    }
}
