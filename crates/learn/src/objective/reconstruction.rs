//! Transition reconstruction, TR: reconstruct the unmasked elements.
//!
//! L_TR = max_θ E_τ Σ_t (1 − I(e_t)) log P_θ(e_t | M(τ)). Same pass as MTP, the other elements. Implemented as a loss
//! to minimise.

use tch::Tensor;

use super::{Objective, sum_per_step};

pub(super) const OBJECTIVE: Objective = Objective {
    name: "tr",
    title: "TR",
    about: "Transition reconstruction: reproduces the elements of a masked segment that are not masked.",
    metric: "loss_tr",
    bidirectional: true,
    loss: |passes| loss(&passes.masked().errors, &passes.masked().masked, &passes.windows.valid),
};

/// The loss, a scalar: `errors` and `masked` as in MTP; `valid` `[W, L]` excludes padding, which is not masked either.
pub(crate) fn loss(errors: &Tensor, masked: &Tensor, valid: &Tensor) -> Tensor {
    let kept = masked.logical_not().logical_and(&valid.unsqueeze(-1));
    sum_per_step(errors, &kept, valid)
}
