//! The settings of training a policy.

use serde::{Deserialize, Serialize};

use super::run::{identity, validate_run};
use super::{Device, OptimSpec, within};
use crate::error::LearnError;

/// Which policy is trained.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PolicyKind {
    /// The pretrained transformer, finetuned: causal pass, action head on the last m token.
    #[default]
    Finetune,
}

/// Settings of [`train_policy`](crate::train_policy).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TrainSpec {
    /// Which policy.
    pub policy: PolicyKind,
    /// Optimiser and batches: each step draws `batch` expert and `batch` kept segments.
    pub optim: OptimSpec,
    /// The paper's λ: weight of the kept imperfect segments.
    pub lambda: f64,
    /// Seed of everything random.
    pub seed: u64,
    /// Steps between checkpoints.
    pub checkpoint_every: u32,
    /// Where to run.
    pub device: Device,
    /// Intra-op threads; unset leaves the process as it is.
    pub threads: Option<u32>,
}

impl Default for TrainSpec {
    fn default() -> Self {
        Self {
            policy: PolicyKind::default(),
            optim: OptimSpec::default(),
            lambda: 0.1,
            seed: 0,
            checkpoint_every: 500,
            device: Device::default(),
            threads: None,
        }
    }
}

impl TrainSpec {
    /// Checks every field.
    ///
    /// # Errors
    /// [`LearnError::Invalid`] naming the field.
    pub fn validate(&self) -> Result<(), LearnError> {
        self.optim.validate()?;
        within("lambda", self.lambda, 0.0, 1e6)?;
        validate_run(self.checkpoint_every, self.threads)
    }

    /// The settings a resumed run must share with the run that wrote the checkpoint.
    pub(crate) fn identity(&self) -> String {
        identity(self)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;

    #[test]
    fn an_empty_object_means_the_papers_settings() {
        let train: TrainSpec = serde_json::from_str("{}").unwrap();
        assert_eq!(train.lambda, 0.1);
        assert!(train.validate().is_ok());
    }

    #[test]
    fn a_resume_may_change_only_how_the_run_is_carried_out() {
        let spec = TrainSpec::default();
        let carried_out = TrainSpec { checkpoint_every: 7, threads: Some(2), ..spec.clone() };
        let different = TrainSpec { seed: 1, ..spec.clone() };
        assert_eq!(spec.identity(), carried_out.identity());
        assert_ne!(spec.identity(), different.identity());
    }
}
