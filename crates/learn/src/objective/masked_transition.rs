//! Masked transition prediction, MTP: predict the masked elements.
//!
//! L_MTP = max_θ E_τ Σ_t I(e_t) log P_θ(e_t | M(τ)), with e_t in {o_t, m_t, a_t} and I(e_t) = 1 where e_t is masked.
//! Implemented as a loss to minimise.

use tch::Tensor;

use super::{Objective, sum_per_step};

pub(super) const OBJECTIVE: Objective = Objective {
    name: "mtp",
    title: "MTP",
    about: "Masked transition prediction: predicts the elements of a segment that are masked.",
    metric: "loss_mtp",
    bidirectional: true,
    loss: |passes| loss(&passes.masked().errors, &passes.masked().masked, &passes.windows.valid),
};

/// The loss, a scalar: `errors` `[W, L, 3]` are those of a pass over M(τ), `masked` `[W, L, 3]` is the indicator, and
/// `valid` `[W, L]` marks the steps inside the episode.
pub(crate) fn loss(errors: &Tensor, masked: &Tensor, valid: &Tensor) -> Tensor {
    sum_per_step(errors, masked, valid)
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
        // MTP: m 2 and a 4. TR: o 1. The padded 9s never count, nor does their step.
        assert_eq!(loss(&errors, &masked, &valid).double_value(&[]), 6.0);
        assert_eq!(reconstruction::loss(&errors, &masked, &valid).double_value(&[]), 1.0);
    }

    /// A mean over the masked and a mean over the other elements would give each masked one three times the weight.
    #[test]
    fn an_element_weighs_the_same_whether_it_is_masked_or_not() {
        let valid = Windows::grid(&[true; 4], &[1, 4], Device::Cpu);
        let weight = |element: usize, masked: usize| {
            let errors: Vec<f32> = (0..12u8).map(|at| f32::from(u8::from(usize::from(at) == element))).collect();
            let errors = Tensor::from_slice(&errors).view([1, 4, 3]);
            let hidden: Vec<bool> = (0..12).map(|at| at < masked).collect();
            let hidden = Windows::grid(&hidden, &[1, 4, 3], Device::Cpu);
            (loss(&errors, &hidden, &valid) + reconstruction::loss(&errors, &hidden, &valid)).double_value(&[])
        };
        for masked in [1, 3, 6, 11] {
            for element in 0..12 {
                assert_eq!(weight(element, masked), 0.25, "element {element} of {masked} masked");
            }
        }
    }
}
