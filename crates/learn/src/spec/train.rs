//! The settings of training a policy.

use serde::{Deserialize, Serialize};

use super::run::{identity, validate_run};
use super::{Augmentation, Device, ModelSpec, OptimSpec, within};
use crate::error::LearnError;

/// Which policy is trained.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PolicyKind {
    /// The pretrained transformer, finetuned: causal pass, action head on the last m token.
    #[default]
    Finetune,
    /// The same transformer and loss, from scratch.
    TfBc,
    /// No history: one step's images and proprioception to its action.
    Bc,
    /// Action chunking with transformers: a conditional VAE that predicts chunks of actions.
    Act,
}

impl PolicyKind {
    /// The word for it in settings and records.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Finetune => "finetune",
            Self::TfBc => "tf_bc",
            Self::Bc => "bc",
            Self::Act => "act",
        }
    }
}

/// Settings of [`PolicyKind::Act`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ActSpec {
    /// Actions predicted at once, k.
    pub chunk_length: u32,
    /// Weight of the style's divergence from N(0, 1).
    pub kl_weight: f64,
    /// Values of the style z.
    pub latent_size: u32,
}

impl Default for ActSpec {
    fn default() -> Self {
        Self { chunk_length: 10, kl_weight: 10.0, latent_size: 16 }
    }
}

impl ActSpec {
    pub(crate) fn validate(&self) -> Result<(), LearnError> {
        within("act.chunk_length", f64::from(self.chunk_length), 1.0, 256.0)?;
        within("act.kl_weight", self.kl_weight, 0.0, 1e6)?;
        within("act.latent_size", f64::from(self.latent_size), 1.0, 1024.0)
    }
}

/// Settings of [`train_policy`](crate::train_policy).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TrainSpec {
    /// Which policy.
    pub policy: PolicyKind,
    /// Size of a policy that starts from scratch, and how much history `tf_bc` sees; `finetune` has
    /// its encoder's.
    pub model: ModelSpec,
    /// Settings of `act`.
    pub act: ActSpec,
    /// Random changes to images.
    pub augmentation: Augmentation,
    /// How often `finetune` and `tf_bc` see a training window without its past, 0 … 1. A policy that always
    /// sees its past learns to go on as it went, which predicts an expert's next action well and acts badly.
    pub history_dropout: f64,
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
            model: ModelSpec::default(),
            act: ActSpec::default(),
            augmentation: Augmentation::default(),
            history_dropout: 0.5,
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
        self.model.validate()?;
        self.act.validate()?;
        self.augmentation.validate()?;
        self.optim.validate()?;
        within("history_dropout", self.history_dropout, 0.0, 1.0)?;
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
    use super::*;

    #[test]
    fn an_empty_object_means_the_defaults() {
        let train: TrainSpec = serde_json::from_str("{}").unwrap();
        assert_eq!(train.lambda, 0.1);
        assert_eq!(train, TrainSpec::default());
        assert!(train.augmentation.is_none() && train.validate().is_ok());
    }

    #[test]
    fn every_policy_is_written_as_its_word() {
        for kind in [PolicyKind::Finetune, PolicyKind::TfBc, PolicyKind::Bc, PolicyKind::Act] {
            assert_eq!(serde_json::to_value(kind).unwrap(), kind.as_str());
        }
    }

    #[test]
    fn settings_out_of_range_are_named() {
        for (text, field) in [
            (r#"{"act": {"chunk_length": 0}}"#, "act.chunk_length: "),
            (r#"{"augmentation": {"contrast": 1.5}}"#, "augmentation.contrast: "),
            (r#"{"model": {"segment_length": 64}}"#, "model.segment_length: "),
        ] {
            let spec: TrainSpec = serde_json::from_str(text).unwrap();
            let message = spec.validate().unwrap_err().to_string();
            assert!(message.starts_with(field), "{message}");
        }
    }

    #[test]
    fn a_resume_may_change_only_how_the_run_is_carried_out() {
        let spec = TrainSpec::default();
        let carried_out = TrainSpec { checkpoint_every: 7, threads: Some(2), ..spec.clone() };
        let different = TrainSpec { seed: 1, ..spec.clone() };
        assert_eq!(spec.identity(), carried_out.identity());
        assert_ne!(spec.identity(), different.identity());
    }

    #[test]
    fn a_chance_beyond_one_is_named() {
        let spec = TrainSpec { history_dropout: 1.5, ..TrainSpec::default() };
        assert!(spec.validate().unwrap_err().to_string().starts_with("history_dropout: "));
    }
}
