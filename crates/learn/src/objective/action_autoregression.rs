//! Action autoregression, AA: predict each action from the history before it.
//!
//! L_AA = max_θ E_τ Σ_t log P_θ(a_t | his(a_t)), his(a_t) = (o_i, m_i, a_i), …, (o_t, m_t). A causal pass. Implemented as a
//! loss to minimise.

use tch::Tensor;

use super::{Objective, squared_error};

pub(super) const OBJECTIVE: Objective = Objective {
    name: "aa",
    title: "AA",
    about: "Action autoregression: predicts each action from the history before it.",
    metric: "loss_aa",
    bidirectional: false,
    loss: |passes| loss(&passes.actions(), &passes.targets.action, &passes.windows.valid),
};

/// The loss, a scalar. `prediction` and `target` are `[W, L, A]`; padding, where `valid` `[W, L]` is false, does not
/// count.
pub(crate) fn loss(prediction: &Tensor, target: &Tensor, valid: &Tensor) -> Tensor {
    let errors = squared_error(prediction, target);
    let valid = valid.to_kind(errors.kind());
    (errors * &valid).sum(None) / valid.sum(None).clamp_min(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::batch::Windows;
    use tch::Device;

    #[test]
    fn padding_does_not_count() {
        let prediction = Tensor::from_slice(&[100.0f32, 1.0, 3.0]).view([1, 3, 1]);
        let target = prediction.zeros_like();
        let valid = Windows::grid(&[false, true, true], &[1, 3], Device::Cpu);
        assert_eq!(loss(&prediction, &target, &valid).double_value(&[]), 5.0);
    }
}
