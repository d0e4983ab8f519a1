//! The options of a job, shared by the commands that plan one: what is not given takes the server's default.

use clap::{Args, ValueEnum};
use gleaner_proto::v1::{Device, OptimSpec, Preset, PretrainSpec, RoleRule, TrainSpec};

/// How large the encoder is.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum PresetArg {
    Tiny,
    Small,
    Base,
}

impl From<PresetArg> for Preset {
    fn from(preset: PresetArg) -> Self {
        match preset {
            PresetArg::Tiny => Self::Tiny,
            PresetArg::Small => Self::Small,
            PresetArg::Base => Self::Base,
        }
    }
}

/// Where a job computes.
#[derive(Clone, Copy, Debug, Default, ValueEnum)]
pub(crate) enum DeviceArg {
    #[default]
    Cpu,
    Cuda,
}

impl From<DeviceArg> for Device {
    fn from(device: DeviceArg) -> Self {
        match device {
            DeviceArg::Cpu => Self::Cpu,
            DeviceArg::Cuda => Self::Cuda,
        }
    }
}

/// Which episodes are experts and which are imperfect. By default success and failure decide.
#[derive(Args, Clone, Debug)]
pub(crate) struct RuleArgs {
    /// Cohort whose episodes are experts, whatever their outcome; may be repeated.
    #[arg(long = "expert-cohort", value_name = "COHORT", requires = "imperfect_cohorts")]
    expert_cohorts: Vec<String>,
    /// Cohort whose episodes are imperfect, whatever their outcome; may be repeated.
    #[arg(long = "imperfect-cohort", value_name = "COHORT", requires = "expert_cohorts")]
    imperfect_cohorts: Vec<String>,
}

impl RuleArgs {
    pub(crate) fn rule(&self) -> RoleRule {
        RoleRule { expert_cohorts: self.expert_cohorts.clone(), imperfect_cohorts: self.imperfect_cohorts.clone() }
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
    pub(crate) device: DeviceArg,
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
    #[arg(long, conflicts_with_all = ["expert_cohorts", "imperfect_cohorts"])]
    snapshot: Option<String>,
    #[command(flatten)]
    rule: RuleArgs,
    /// Size of the encoder.
    #[arg(long, value_enum, default_value = "tiny")]
    preset: PresetArg,
    /// Steps beside the last that a segment spans (the paper's l).
    #[arg(long, value_name = "L")]
    segment_length: Option<u32>,
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
            preset: Preset::from(self.preset).into(),
            segment_length: self.segment_length,
            optim: Some(self.run.optim()),
            seed: self.run.seed,
            device: Device::from(self.run.device).into(),
            checkpoint_every: self.checkpoint_every,
        }
    }

    pub(crate) fn seed(&self) -> u64 {
        self.run.seed
    }

    pub(crate) fn device(&self) -> DeviceArg {
        self.run.device
    }
}

/// Optimiser settings of which these are given.
pub(crate) fn optim(steps: Option<u32>, batch: Option<u32>, learning_rate: Option<f64>) -> OptimSpec {
    OptimSpec { steps, batch, learning_rate, ..OptimSpec::default() }
}

/// A training on data that is filled in later.
pub(crate) fn train(optim: OptimSpec, lambda: Option<f64>, seed: u64, device: DeviceArg) -> TrainSpec {
    TrainSpec {
        data: None,
        optim: Some(optim),
        lambda,
        seed,
        device: Device::from(device).into(),
        checkpoint_every: None,
    }
}
