//! Steps to tokens. Projections do not depend on the window and are computed once per step; the mask token and the
//! embeddings of modality and time do, and are added when windows are laid out.

use tch::Tensor;
use tch::nn::{self, Module};

use crate::batch::{Windows, int};
use crate::shape::TaskShape;

/// A modality's place among the three tokens of a step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Modality {
    /// Images o.
    Image = 0,
    /// Proprioception m.
    Proprioception = 1,
    /// Action a.
    Action = 2,
}

/// Number of modalities.
pub(crate) const MODALITIES: i64 = 3;

impl Modality {
    /// This modality's part of `[..., 3, d]`, as `[..., d]`.
    pub(crate) fn of(self, features: &Tensor) -> Tensor {
        features.select(-2, self as i64)
    }
}

/// Projections and embeddings.
pub(crate) struct Tokens {
    proprioception: nn::Linear,
    action: nn::Linear,
    /// `[3, d]`.
    modality: Tensor,
    /// `[L, 1, d]`; the last entry is the window's end, wherever padding ends.
    time: Tensor,
    /// `[3, d]`: the replacement of a masked element.
    mask: Tensor,
}

impl Tokens {
    pub(super) fn new(path: &nn::Path<'_>, shape: &TaskShape, width: i64, window: usize) -> Self {
        let linear = |name: &str, inputs| nn::linear(path / name, int(inputs), width, Default::default());
        Self {
            proprioception: linear("proprioception", shape.proprioception),
            action: linear("action", shape.action),
            modality: path.zeros("modality_embedding", &[MODALITIES, width]),
            time: path.zeros("time_embedding", &[int(window), 1, width]),
            mask: path.zeros("mask_embedding", &[MODALITIES, width]),
        }
    }

    /// Embedded o `[N, d]`, standardised m `[N, M]` and a `[N, A]`, to `[N, 3, d]`.
    pub(super) fn steps(&self, o: &Tensor, m: &Tensor, a: &Tensor) -> Tensor {
        let m = self.proprioception.forward(m);
        let a = self.action.forward(a);
        Tensor::stack(&[o, &m, &a], 1)
    }

    /// Steps `[N, 3, d]` laid out as windows `[W, 3 L, d]`, ordered o, m, a within a step.
    pub(super) fn windows(&self, steps: &Tensor, windows: &Windows, hidden: Option<&Tensor>) -> Tensor {
        let width = steps.size()[2];
        let length = int(windows.length);
        let mut tokens = steps.index_select(0, &windows.index).view([-1, length, MODALITIES, width]);
        if let Some(hidden) = hidden {
            tokens = self.mask.where_self(&hidden.unsqueeze(-1), &tokens);
        }
        (tokens + &self.modality + &self.time).view([-1, length * MODALITIES, width])
    }
}
