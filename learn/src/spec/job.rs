//! The settings of the three jobs: pretrain, score and train.

use serde::{Deserialize, Serialize};

use super::{Device, ModelSpec, OptimSpec, within};
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

/// Settings of [`pretrain`](crate::pretrain).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PretrainSpec {
    /// The encoder to train.
    pub model: ModelSpec,
    /// The objectives to add up; all three by default, as the paper does.
    pub objectives: Vec<Objective>,
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

/// How two segments' features are compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Similarity {
    /// Negative sum over o, m, a of the Euclidean distance between last-step features.
    #[default]
    LastL2,
}

/// How similarities become quality scores.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum NormaliserKind {
    /// Smallest and largest similarity of the run's imperfect segments become 0 and 1.
    #[default]
    MinMax,
}

/// Settings of [`score`](fn@crate::score).
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ScoreSpec {
    /// How segments are compared.
    pub similarity: Similarity,
    /// How similarities become scores.
    pub normaliser: NormaliserKind,
    /// Factors of the o, m and a distances; unset means 1, 1, 1 as in the paper.
    pub modality_scale: Option<[f64; 3]>,
    /// Where to run.
    pub device: Device,
    /// Intra-op threads; unset leaves the process as it is.
    pub threads: Option<u32>,
}

impl ScoreSpec {
    /// Checks every field.
    ///
    /// # Errors
    /// [`LearnError::Invalid`] naming the field.
    pub fn validate(&self) -> Result<(), LearnError> {
        let scale = self.scale();
        for (i, factor) in scale.iter().enumerate() {
            within(&format!("modality_scale[{i}]"), *factor, 0.0, 1e6)?;
        }
        if scale.iter().all(|factor| *factor == 0.0) {
            return Err(LearnError::invalid("modality_scale", "is zero for every modality; at least one must count"));
        }
        validate_run(1, self.threads)
    }

    /// Factors of the o, m and a distances.
    pub(crate) fn scale(&self) -> [f64; 3] {
        self.modality_scale.unwrap_or([1.0; 3])
    }
}

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

fn validate_run(checkpoint_every: u32, threads: Option<u32>) -> Result<(), LearnError> {
    if checkpoint_every == 0 {
        return Err(LearnError::invalid("checkpoint_every", "must be at least 1"));
    }
    within("threads", f64::from(threads.unwrap_or(1)), 1.0, 1024.0)
}

/// The settings as JSON without those that only say how a run is carried out. The specs hold only
/// numbers, strings and lists, so they always have a JSON form.
fn identity(spec: &impl Serialize) -> String {
    let mut json = serde_json::to_value(spec).unwrap_or_default();
    if let Some(fields) = json.as_object_mut() {
        for field in ["checkpoint_every", "device", "threads"] {
            fields.remove(field);
        }
    }
    json.to_string()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;

    #[test]
    fn an_empty_object_means_the_papers_settings() {
        let train: TrainSpec = serde_json::from_str("{}").unwrap();
        assert_eq!(train.lambda, 0.1);
        let pretrain: PretrainSpec = serde_json::from_str("{}").unwrap();
        assert_eq!(pretrain.model.segment_length, 6);
        assert_eq!(pretrain.objectives.len(), 3);
        assert!(pretrain.validate().is_ok() && train.validate().is_ok());
    }

    #[test]
    fn a_misspelt_field_is_refused() {
        let error = serde_json::from_str::<PretrainSpec>(r#"{"optim":{"batchs":3}}"#).unwrap_err();
        assert!(error.to_string().contains("batchs"), "{error}");
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
    fn a_scale_that_counts_nothing_is_refused() {
        let spec = ScoreSpec { modality_scale: Some([0.0; 3]), ..ScoreSpec::default() };
        assert!(spec.validate().is_err());
    }
}
