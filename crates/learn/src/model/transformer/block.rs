//! One layer of a transformer: attention among tokens and a perceptron, each after a norm and beside a shortcut.
//! Independent of what the tokens are.

use tch::Tensor;
use tch::nn::{self, Module};

use crate::dropout::dropped;
use crate::model::Size;
use crate::model::layers::Linear;

/// Attention with several heads.
pub(super) struct MultiHead {
    heads: i64,
    query: Linear,
    key_value: Linear,
    out: Linear,
}

impl MultiHead {
    pub(super) fn new(path: &nn::Path<'_>, size: &Size) -> Self {
        let d = size.width;
        let linear = |name: &str, to| Linear::new(path / name, d, to);
        Self {
            heads: size.heads,
            query: linear("query", d),
            key_value: linear("key_value", 2 * d),
            out: linear("out", d),
        }
    }

    /// What `queries` `[W, Q, d]` read of `keys` `[W, S, d]`, `[W, Q, d]`. `mask` `[W or 1, 1, Q, S]` is true where a
    /// query may attend to a key; `None`: every query attends to every key.
    pub(super) fn forward(&self, queries: &Tensor, keys: &Tensor, mask: Option<&Tensor>) -> Tensor {
        let query = self.query.forward(queries);
        let key_value = self.key_value.forward(keys).chunk(2, -1);
        let seen = Tensor::scaled_dot_product_attention(
            &self.split(&query),
            &self.split(&key_value[0]),
            &self.split(&key_value[1]),
            mask,
            0.0,
            false,
            None,
            false,
        );
        dropped(self.out.forward(&seen.transpose(1, 2).flatten(2, -1)))
    }

    /// `[W, S, d]` to `[W, heads, S, d / heads]`.
    fn split(&self, x: &Tensor) -> Tensor {
        x.unflatten(-1, [self.heads, -1]).transpose(1, 2)
    }
}

/// Attention among tokens, and a perceptron of each.
pub(super) struct Block {
    before_attention: nn::LayerNorm,
    attention: MultiHead,
    before_mlp: nn::LayerNorm,
    up: Linear,
    down: Linear,
}

impl Block {
    pub(super) fn new(path: &nn::Path<'_>, size: &Size) -> Self {
        let d = size.width;
        let linear = |name: &str, from, to| Linear::new(path / name, from, to);
        let norm = |name: &str| nn::layer_norm(path / name, vec![d], Default::default());
        Self {
            before_attention: norm("attention_norm"),
            attention: MultiHead::new(path, size),
            before_mlp: norm("mlp_norm"),
            up: linear("up", d, 4 * d),
            down: linear("down", 4 * d, d),
        }
    }

    /// `x` is `[W, S, d]`; returns the last `keep` tokens `[W, keep, d]`.
    pub(super) fn forward(&self, x: &Tensor, mask: Option<&Tensor>, keep: i64) -> Tensor {
        self.feed(&self.attend(x, mask, keep))
    }

    /// The first half of the layer: attention, with a mask as in [`MultiHead::forward`] for every token.
    pub(super) fn attend(&self, x: &Tensor, mask: Option<&Tensor>, keep: i64) -> Tensor {
        let first = x.size()[1] - keep;
        let normed = self.before_attention.forward(x);
        let mask = mask.map(|mask| mask.narrow(2, first, keep));
        let seen = self.attention.forward(&normed.narrow(1, first, keep), &normed, mask.as_ref());
        x.narrow(1, first, keep) + seen
    }

    /// The second half: the perceptron.
    pub(super) fn feed(&self, x: &Tensor) -> Tensor {
        let inner = self.up.forward(&self.before_mlp.forward(x)).gelu("none");
        x + dropped(self.down.forward(&inner))
    }
}
