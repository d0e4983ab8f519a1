//! The options of a job, shared by the commands that plan one: what is not given takes the server's default.

use clap::Args;
use gleaner_proto::v1::{
    ActSpec, Augmentation, ModalityScale, OptimSpec, PretrainSpec, RoleRule, ScoreSpec, TrainSpec,
};

use crate::choice::{
    DeviceWord, FeatureScaleWord, NormaliserWord, ObjectiveWord, PolicyWord, PresetWord, ScorerWord, SimilarityWord,
    YardstickWord,
};

/// Which episodes are experts and which are imperfect. By default success and failure decide.
#[derive(Args, Clone, Debug)]
pub(crate) struct RuleArgs {
    /// Cohort whose episodes are experts, whatever their outcome; may be repeated.
    #[arg(long = "expert-cohort", value_name = "COHORT", requires = "imperfect_cohorts")]
    expert_cohorts: Vec<String>,
    /// Cohort whose episodes are imperfect, whatever their outcome; may be repeated.
    #[arg(long = "imperfect-cohort", value_name = "COHORT", requires = "expert_cohorts")]
    imperfect_cohorts: Vec<String>,
    /// At most so many imperfect episodes for each expert, spread evenly over the cohorts; 0: all.
    #[arg(long, value_name = "RATIO", default_value_t = 0.0, hide_default_value = true)]
    imperfect_per_expert: f64,
    /// At most so many experts; 0: all.
    #[arg(long, value_name = "N", default_value_t = 0, hide_default_value = true)]
    max_experts: u32,
    /// Chooses which episodes a limit leaves in; with the same seed, fewer are a part of more.
    #[arg(long, value_name = "SEED", default_value_t = 0, hide_default_value = true)]
    rule_seed: u64,
}

impl RuleArgs {
    pub(crate) fn rule(&self) -> RoleRule {
        RoleRule {
            expert_cohorts: self.expert_cohorts.clone(),
            imperfect_cohorts: self.imperfect_cohorts.clone(),
            imperfect_per_expert: self.imperfect_per_expert,
            max_experts: self.max_experts,
            seed: self.rule_seed,
        }
    }
}

/// Options of everything that is optimised.
#[derive(Args, Clone, Debug)]
pub(crate) struct RunArgs {
    /// Optimiser steps.
    #[arg(long)]
    pub(crate) steps: Option<u32>,
    /// Segments a step.
    #[arg(long)]
    pub(crate) batch: Option<u32>,
    /// Learning rate.
    #[arg(long)]
    pub(crate) lr: Option<f64>,
    /// Seed of everything random.
    #[arg(long, default_value_t = 0)]
    pub(crate) seed: u64,
    /// Where to compute.
    #[arg(long, value_enum, default_value = "cpu")]
    pub(crate) device: DeviceWord,
}

impl RunArgs {
    pub(crate) fn optim(&self) -> OptimSpec {
        optim(self.steps, self.batch, self.lr)
    }
}

/// Options of a pretraining.
#[derive(Args, Clone, Debug)]
pub(crate) struct PretrainArgs {
    /// An existing snapshot; by default one is made now.
    #[arg(long, conflicts_with_all = [
        "expert_cohorts", "imperfect_cohorts", "imperfect_per_expert", "max_experts", "rule_seed"
    ])]
    snapshot: Option<String>,
    #[command(flatten)]
    rule: RuleArgs,
    /// Size of the encoder.
    #[arg(long, value_enum, default_value = "tiny")]
    preset: PresetWord,
    /// Steps beside the last that a segment spans (the paper's l).
    #[arg(long, value_name = "L")]
    segment_length: Option<u32>,
    /// Self-supervised objectives; by default all three.
    #[arg(long = "objective", value_enum, value_delimiter = ',', value_name = "mtp,tr,aa")]
    objectives: Vec<ObjectiveWord>,
    #[command(flatten)]
    augmentation: AugmentationArgs,
    #[command(flatten)]
    run: RunArgs,
    /// Steps between checkpoints.
    #[arg(long, value_name = "STEPS")]
    checkpoint_every: Option<u32>,
}

impl PretrainArgs {
    pub(crate) fn spec(&self) -> PretrainSpec {
        PretrainSpec {
            snapshot_id: self.snapshot.clone().unwrap_or_default(),
            rule: Some(self.rule.rule()),
            preset: self.preset.into(),
            segment_length: self.segment_length,
            optim: Some(self.run.optim()),
            seed: self.run.seed,
            device: self.run.device.into(),
            checkpoint_every: self.checkpoint_every,
            objectives: self.objectives.iter().map(|objective| (*objective).into()).collect(),
            augmentation: self.augmentation.spec(),
        }
    }

    pub(crate) fn augmentation(&self) -> Option<Augmentation> {
        self.augmentation.spec()
    }

    pub(crate) fn seed(&self) -> u64 {
        self.run.seed
    }

    pub(crate) fn device(&self) -> DeviceWord {
        self.run.device
    }
}

/// Optimiser settings of which these are given.
pub(crate) fn optim(steps: Option<u32>, batch: Option<u32>, learning_rate: Option<f64>) -> OptimSpec {
    OptimSpec { steps, batch, learning_rate, ..OptimSpec::default() }
}

/// Random changes to the images of training batches.
#[derive(Args, Clone, Debug)]
pub(crate) struct AugmentationArgs {
    /// Move images by up to so many pixels.
    #[arg(long, value_name = "PIXELS", default_value_t = 0, hide_default_value = true)]
    shift_pixels: u32,
    /// Brighten or darken images by up to this part of full scale.
    #[arg(long, value_name = "PART", default_value_t = 0.0, hide_default_value = true)]
    brightness: f64,
    /// Stretch images' colours by a factor in 1 ± this.
    #[arg(long, value_name = "PART", default_value_t = 0.0, hide_default_value = true)]
    contrast: f64,
}

impl AugmentationArgs {
    fn spec(&self) -> Option<Augmentation> {
        let Self { shift_pixels, brightness, contrast } = *self;
        let spec = Augmentation { shift_pixels, brightness, contrast };
        (spec != Augmentation::default()).then_some(spec)
    }
}

/// How segments are scored.
#[derive(Args, Clone, Debug)]
pub(crate) struct ScoringArgs {
    /// What gives segments their score.
    #[arg(long, value_enum)]
    scorer: Option<ScorerWord>,
    /// How segments are compared.
    #[arg(long, value_enum)]
    similarity: Option<SimilarityWord>,
    /// How similarities become qualities in [0, 1].
    #[arg(long, value_enum)]
    normaliser: Option<NormaliserWord>,
    /// What features are measured in before they are compared.
    #[arg(long, value_enum)]
    feature_scale: Option<FeatureScaleWord>,
    /// What similarities are measured against before they are normalised.
    #[arg(long, value_enum)]
    yardstick: Option<YardstickWord>,
    /// Factors of the distances of image, proprioception and action.
    #[arg(long, value_delimiter = ',', num_args = 1, value_name = "O,M,A", value_parser = scale_factor)]
    scale: Vec<f64>,
}

fn scale_factor(text: &str) -> Result<f64, String> {
    text.trim().parse().map_err(|_| format!("{text:?} is not a number; write three, for example 1,0.5,1"))
}

impl ScoringArgs {
    /// A scoring with an encoder and a snapshot that are filled in later.
    pub(crate) fn spec(&self, seed: u64, device: DeviceWord) -> crate::failure::Result<ScoreSpec> {
        let modality_scale = match self.scale[..] {
            [] => None,
            [image, proprioception, action] => Some(ModalityScale { image, proprioception, action }),
            _ => return Err(crate::failure::Failure::told("--scale: give three factors, O,M,A; for example 1,0.5,1")),
        };
        Ok(ScoreSpec {
            scorer: self.scorer.map(i32::from).unwrap_or_default(),
            similarity: self.similarity.map(i32::from).unwrap_or_default(),
            normaliser: self.normaliser.map(i32::from).unwrap_or_default(),
            modality_scale,
            feature_scale: self.feature_scale.map(i32::from).unwrap_or_default(),
            yardstick: self.yardstick.map(i32::from).unwrap_or_default(),
            device: device.into(),
            seed,
            ..ScoreSpec::default()
        })
    }
}

/// Which policy, and the settings that only training has.
#[derive(Args, Clone, Debug)]
pub(crate) struct PolicyArgs {
    /// Which policy is trained.
    #[arg(long, value_enum)]
    policy: Option<PolicyWord>,
    /// ACT: actions predicted at once.
    #[arg(long, value_name = "K")]
    chunk_length: Option<u32>,
    /// ACT: weight of the divergence of its latent.
    #[arg(long, value_name = "WEIGHT")]
    kl_weight: Option<f64>,
    /// ACT: size of its latent.
    #[arg(long, value_name = "SIZE")]
    latent_size: Option<u32>,
    /// Weight of the kept segments' loss.
    #[arg(long)]
    lambda: Option<f64>,
    /// Policies with a history: how often a training window's past is hidden.
    #[arg(long, value_name = "CHANCE")]
    history_dropout: Option<f64>,
}

impl PolicyArgs {
    /// A training on data that is filled in later.
    pub(crate) fn spec(&self, optim: OptimSpec, seed: u64, device: DeviceWord) -> TrainSpec {
        let act = ActSpec { chunk_length: self.chunk_length, kl_weight: self.kl_weight, latent_size: self.latent_size };
        TrainSpec {
            optim: Some(optim),
            lambda: self.lambda,
            history_dropout: self.history_dropout,
            seed,
            device: device.into(),
            policy: self.policy.map(i32::from).unwrap_or_default(),
            act: (act != ActSpec::default()).then_some(act),
            ..TrainSpec::default()
        }
    }
}

/// Settings of a training that stands alone.
#[derive(Args, Clone, Debug)]
pub(crate) struct FromScratchArgs {
    #[command(flatten)]
    augmentation: AugmentationArgs,
    /// Size of a policy that starts from scratch; finetune has its encoder's.
    #[arg(long, value_enum)]
    preset: Option<PresetWord>,
    /// History that a policy from scratch sees (the paper's l).
    #[arg(long, value_name = "L")]
    segment_length: Option<u32>,
}

impl FromScratchArgs {
    pub(crate) fn apply(&self, spec: TrainSpec) -> TrainSpec {
        TrainSpec {
            augmentation: self.augmentation.spec(),
            preset: self.preset.map(i32::from).unwrap_or_default(),
            segment_length: self.segment_length,
            ..spec
        }
    }
}
