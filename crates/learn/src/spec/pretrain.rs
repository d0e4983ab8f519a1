//! The settings of pretraining.

use serde::{Deserialize, Serialize};

use super::run::{identity, validate_run};
use super::{Augmentation, Device, ModelSpec, OptimSpec};
use crate::error::LearnError;

/// A self-supervised objective of pretraining.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Objective {
    /// Masked transition prediction.
    Mtp,
    /// Transition reconstruction.
    Tr,
    /// Action autoregression.
    Aa,
}

impl Objective {
    /// The word for it in settings and records.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Mtp => "mtp",
            Self::Tr => "tr",
            Self::Aa => "aa",
        }
    }
}

/// Settings of [`pretrain`](crate::pretrain).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PretrainSpec {
    /// The encoder to train.
    pub model: ModelSpec,
    /// The objectives to add up; all three by default, as the paper does.
    pub objectives: Vec<Objective>,
    /// Random changes to images; none by default.
    pub augmentation: Augmentation,
    /// Optimiser and batches.
    pub optim: OptimSpec,
    /// Seed of everything random.
    pub seed: u64,
    /// Steps between checkpoints.
    pub checkpoint_every: u32,
    /// Where to run.
    pub device: Device,
    /// Intra-op threads; unset leaves the process as it is. Numbers repeat bit for bit only
    /// between runs with the same number of threads.
    pub threads: Option<u32>,
}

impl Default for PretrainSpec {
    fn default() -> Self {
        Self {
            model: ModelSpec::default(),
            objectives: vec![Objective::Mtp, Objective::Tr, Objective::Aa],
            augmentation: Augmentation::default(),
            optim: OptimSpec::default(),
            seed: 0,
            checkpoint_every: 500,
            device: Device::default(),
            threads: None,
        }
    }
}

impl PretrainSpec {
    /// Checks every field.
    ///
    /// # Errors
    /// [`LearnError::Invalid`] naming the field.
    pub fn validate(&self) -> Result<(), LearnError> {
        self.model.validate()?;
        self.augmentation.validate()?;
        self.optim.validate()?;
        if self.objectives.is_empty() {
            return Err(LearnError::invalid("objectives", "is empty; name at least one of mtp, tr, aa"));
        }
        validate_run(self.checkpoint_every, self.threads)
    }

    /// The settings a resumed run must share with the run that wrote the checkpoint.
    pub(crate) fn identity(&self) -> String {
        identity(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_empty_object_means_the_papers_settings() {
        let pretrain: PretrainSpec = serde_json::from_str("{}").unwrap();
        assert_eq!(pretrain.model.segment_length, 6);
        assert_eq!(pretrain.objectives.len(), 3);
        assert!(pretrain.validate().is_ok());
    }

    #[test]
    fn a_misspelt_field_is_refused() {
        let error = serde_json::from_str::<PretrainSpec>(r#"{"optim":{"batchs":3}}"#).unwrap_err();
        assert!(error.to_string().contains("batchs"), "{error}");
    }
}
