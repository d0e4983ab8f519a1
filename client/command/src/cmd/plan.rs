//! Which episodes a job learns from: options shared by the commands that make snapshots.

use clap::Args;
use gleaner_core::Values;
use gleaner_core::proto::to_struct;
use gleaner_proto::v1::{PretrainSpec, RoleRule};

/// Which episodes are experts and which are imperfect. By default success and failure decide.
#[derive(Args, Clone, Debug)]
pub(crate) struct RuleArgs {
    /// Cohort whose episodes are experts, regardless of their outcome; can be repeated. Default: every success, whatever its
    /// cohort.
    #[arg(long = "expert-cohort", value_name = "COHORT")]
    expert_cohorts: Vec<String>,
    /// Cohort whose episodes are imperfect, regardless of their outcome; can be repeated. Failures of other cohorts are then
    /// left out. Default: every failure, whatever its cohort.
    #[arg(long = "imperfect-cohort", value_name = "COHORT")]
    imperfect_cohorts: Vec<String>,
    /// Maximum number of imperfect episodes for each expert, spread evenly over the cohorts (0: all). Fewer take less
    /// time.
    #[arg(long, value_name = "RATIO", default_value_t = 0.0, hide_default_value = true)]
    imperfect_per_expert: f64,
    /// Maximum number of experts (0: all).
    #[arg(long, value_name = "N", default_value_t = 0, hide_default_value = true)]
    max_experts: u32,
    /// Sampling seed. With the same seed, a smaller limit selects a subset of a larger one.
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

/// What a pretraining learns from.
#[derive(Args, Clone, Debug)]
pub(crate) struct SnapshotArgs {
    /// Id of an existing snapshot. Default: a new snapshot of the task.
    #[arg(long, conflicts_with_all = [
        "expert_cohorts", "imperfect_cohorts", "imperfect_per_expert", "max_experts", "rule_seed"
    ])]
    snapshot: Option<String>,
    #[command(flatten)]
    rule: RuleArgs,
}

impl SnapshotArgs {
    /// A pretraining with these settings.
    pub(crate) fn pretrain(&self, settings: &Values) -> PretrainSpec {
        PretrainSpec {
            snapshot_id: self.snapshot.clone().unwrap_or_default(),
            rule: Some(self.rule.rule()),
            settings: Some(to_struct(settings)),
        }
    }
}
