//! Steps to tokens. Projections do not depend on the window and are computed once per step; the mask token and the
//! embeddings of modality and time do, and are added when windows are laid out.

use tch::Tensor;
use tch::nn::{self, Module};

use crate::batch::{Windows, int};
use crate::shape::TaskShape;
use gleaner_core::{ActionToken, ModelSpec};

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
    /// The token that the action is read from; `None` if that is one of a modality.
    query: Option<Query>,
}

/// A token that the action is read from.
enum Query {
    /// `[1, d]`: the same at every step.
    Learned(Tensor),
    /// Made of a step's o and m.
    Fused { hidden: nn::Linear, out: nn::Linear },
}

/// Width of a fused query's hidden layer, in multiples of d.
const HIDDEN: i64 = 4;

impl Query {
    fn new(path: &nn::Path<'_>, token: ActionToken, width: i64) -> Option<Self> {
        let linear = |name: &str, from, to| nn::linear(path / name, from, to, Default::default());
        match token {
            ActionToken::Proprioception | ActionToken::Image => None,
            ActionToken::Query => Some(Self::Learned(path.zeros("query_embedding", &[1, width]))),
            ActionToken::Fused => Some(Self::Fused {
                hidden: linear("query_hidden", 2 * width, HIDDEN * width),
                out: linear("query_out", HIDDEN * width, width),
            }),
        }
    }

    /// The query of each step `[N, 3, d]`, to `[N, d]`.
    fn of(&self, steps: &Tensor) -> Tensor {
        match self {
            Self::Learned(query) => query.expand([steps.size()[0], -1], false),
            Self::Fused { hidden, out } => {
                out.forward(&hidden.forward(&steps.narrow(1, 0, 2).flatten(1, 2)).gelu("none"))
            }
        }
    }
}

impl Tokens {
    pub(super) fn new(path: &nn::Path<'_>, shape: &TaskShape, width: i64, spec: &ModelSpec) -> Self {
        let linear = |name: &str, inputs| nn::linear(path / name, int(inputs), width, Default::default());
        Self {
            proprioception: linear("proprioception", shape.proprioception),
            action: linear("action", shape.action),
            modality: path.zeros("modality_embedding", &[MODALITIES, width]),
            time: path.zeros("time_embedding", &[int(spec.window()), 1, width]),
            mask: path.zeros("mask_embedding", &[MODALITIES, width]),
            query: Query::new(path, spec.action_token, width),
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
        self.places(steps, windows, hidden).flatten(1, 2)
    }

    /// As [`Tokens::windows`], with a query after each step's m: `[W, 4 L, d]`, or, if the action of the `newest` step alone
    /// is read, `[W, 3 L, d]` with a query in place of its a, which is not known yet. `None` for a model without query.
    pub(super) fn queried(
        &self,
        steps: &Tensor,
        windows: &Windows,
        hidden: Option<&Tensor>,
        newest: bool,
    ) -> Option<Tensor> {
        let query = self.query.as_ref()?.of(steps).unsqueeze(1).index_select(0, &windows.index);
        let query = query.unflatten(0, [-1, int(windows.length)]) + &self.time;
        let places = self.places(steps, windows, hidden);
        if newest {
            let known = places.flatten(1, 2);
            let known = known.narrow(1, 0, known.size()[1] - 1);
            return Some(Tensor::cat(&[known, query.select(1, -1)], 1));
        }
        let (seen, action) = (places.narrow(2, 0, 2), places.narrow(2, 2, 1));
        Some(Tensor::cat(&[seen, query, action], 2).flatten(1, 2))
    }

    /// Every place's tokens, `[W, L, 3, d]`.
    fn places(&self, steps: &Tensor, windows: &Windows, hidden: Option<&Tensor>) -> Tensor {
        let width = steps.size()[2];
        let length = int(windows.length);
        let mut tokens = steps.index_select(0, &windows.index).view([-1, length, MODALITIES, width]);
        if let Some(hidden) = hidden {
            tokens = self.mask.where_self(&hidden.unsqueeze(-1), &tokens);
        }
        tokens + &self.modality + &self.time
    }
}
