//! Masked transition prediction, MTP: predict the masked elements.
//!
//! L_MTP = max_θ E_τ Σ_t I(e_t) log P_θ(e_t | M(τ)), with e_t in {o_t, m_t, a_t} and I(e_t) = 1 where e_t is masked.
//! Implemented as a loss to minimise.

use tch::Tensor;

use super::{Objective, modality_mean};

pub(super) const OBJECTIVE: Objective = Objective {
    name: "mtp",
    title: "MTP",
    about: "Masked transition prediction: predicts the elements of a segment that are masked.",
    metric: "loss_mtp",
    bidirectional: true,
    loss: |passes| loss(&passes.masked().errors, &passes.masked().masked),
};

/// The loss, a scalar: `errors` `[W, L, 3]` are those of a pass over M(τ), `masked` `[W, L, 3]` is the indicator.
pub(crate) fn loss(errors: &Tensor, masked: &Tensor) -> Tensor {
    modality_mean(errors, masked)
}

#[cfg(test)]
mod tests {
    use super::super::reconstruction;
    use super::*;
    use crate::batch::Windows;
    use tch::Device;

    /// One window of two steps, the first of them padding; m_1 and a_1 are masked.
    #[test]
    fn masked_and_unmasked_losses_are_complements_without_padding() {
        let errors = Tensor::from_slice(&[9.0f32, 9.0, 9.0, 1.0, 2.0, 4.0]).view([1, 2, 3]);
        let masked = [false, false, false, false, true, true];
        let masked = Windows::grid(&masked, &[1, 2, 3], Device::Cpu);
        let valid = Windows::grid(&[false, true], &[1, 2], Device::Cpu);
        // MTP: o has no error, m 2, a 4. TR: o 1, m and a have no error. The padded 9s never count.
        assert_eq!(loss(&errors, &masked).double_value(&[]), 2.0);
        let reconstructed = reconstruction::loss(&errors, &masked, &valid);
        assert!((reconstructed.double_value(&[]) - 1.0 / 3.0).abs() < 1e-7);
    }

    #[test]
    fn a_modality_weighs_the_same_however_many_of_it_are_masked() {
        let errors = Tensor::from_slice(&[3.0f32, 6.0, 9.0, 3.0, 0.0, 0.0]).view([1, 2, 3]);
        let masked = [true, true, true, true, false, false];
        let masked = Windows::grid(&masked, &[1, 2, 3], Device::Cpu);
        assert_eq!(loss(&errors, &masked).double_value(&[]), (3.0 + 6.0 + 9.0) / 3.0);
    }
}
