//! How a model is optimised: AdamW with a warm-up and a cosine decay to zero.

use serde::{Deserialize, Serialize};

use super::within;
use crate::error::LearnError;

/// Settings of the optimiser and of the batches.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct OptimSpec {
    /// Gradient steps.
    pub steps: u64,
    /// Segments per batch.
    pub batch: u32,
    /// Consecutive segments drawn together, so that frames they share are encoded once. More is
    /// faster, fewer makes a batch more varied.
    pub stretch: u32,
    /// Highest learning rate.
    pub learning_rate: f64,
    /// Decoupled weight decay of matrices; biases, norms and embeddings have none.
    pub weight_decay: f64,
    /// Steps over which the learning rate rises from zero.
    pub warmup_steps: u64,
    /// Largest global gradient norm; larger gradients are scaled down to it.
    pub clip_norm: f64,
}

impl Default for OptimSpec {
    fn default() -> Self {
        Self {
            steps: 2_000,
            batch: 64,
            stretch: 8,
            learning_rate: 1e-3,
            weight_decay: 0.01,
            warmup_steps: 50,
            clip_norm: 1.0,
        }
    }
}

impl OptimSpec {
    pub(crate) fn validate(&self) -> Result<(), LearnError> {
        if self.steps == 0 {
            return Err(LearnError::invalid("optim.steps", "must be at least 1"));
        }
        within("optim.batch", f64::from(self.batch), 1.0, 65_536.0)?;
        within("optim.stretch", f64::from(self.stretch), 1.0, 65_536.0)?;
        within("optim.learning_rate", self.learning_rate, 1e-12, 10.0)?;
        within("optim.weight_decay", self.weight_decay, 0.0, 10.0)?;
        within("optim.clip_norm", self.clip_norm, 1e-12, 1e12)
    }

    /// The learning rate of `step` (from 0): linear warm-up times a cosine that ends at zero.
    pub(crate) fn learning_rate_at(&self, step: u64) -> f64 {
        #[expect(clippy::cast_precision_loss, reason = "step counts are far below 2^52")]
        let (done, total, warmup) = (step as f64, self.steps as f64, self.warmup_steps.max(1) as f64);
        let rise = ((done + 1.0) / warmup).min(1.0);
        let fall = 0.5 * (1.0 + (std::f64::consts::PI * done / total).cos());
        self.learning_rate * rise * fall
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rate_rises_then_falls_to_nearly_zero() {
        let spec = OptimSpec { steps: 100, warmup_steps: 10, learning_rate: 1.0, ..OptimSpec::default() };
        assert!((spec.learning_rate_at(0) - 0.1).abs() < 1e-12);
        assert!(spec.learning_rate_at(9) > 0.97);
        assert!((spec.learning_rate_at(50) - 0.5).abs() < 1e-12);
        assert!(spec.learning_rate_at(99) < 1e-3);
    }

    #[test]
    fn a_value_out_of_range_is_named() {
        let spec = OptimSpec { learning_rate: f64::NAN, ..OptimSpec::default() };
        let message = spec.validate().unwrap_err().to_string();
        assert!(message.starts_with("optim.learning_rate: "), "{message}");
    }
}
