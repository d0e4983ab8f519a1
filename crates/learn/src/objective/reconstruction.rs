//! Transition reconstruction, TR: give back what is not masked.
//!
//! L_TR = max_θ E_τ Σ_t (1 − I(e_t)) log P_θ(e_t | M(τ)). Same pass as MTP, the other elements.
//! Here as a loss to minimise.

use tch::Tensor;

use super::modality_mean;

/// `errors` and `masked` as in MTP; `valid` `[W, L]` leaves padding out, which is not masked
/// either; a scalar.
pub(crate) fn loss(errors: &Tensor, masked: &Tensor, valid: &Tensor) -> Tensor {
    let kept = masked.logical_not().logical_and(&valid.unsqueeze(-1));
    modality_mean(errors, &kept)
}
