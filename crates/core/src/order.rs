//! Orders: what a caller asks for, before the server has chosen inputs and ids.

use crate::{EvaluateSpec, PretrainSpec, ScoreSpec, TrainSpec, kinds::Family};

use super::{
    dataset::Dataset,
    id::{DatasetId, EncoderId, JobId, PolicyId, ScoreRunId, SnapshotId, TaskId},
    job::{JobKind, JobSpec, JobState},
    schedule::ScheduleStart,
    snapshot::RoleRule,
};

/// What a caller asks a job to do. What is left out the server chooses. Kept beside a job that has a key.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum JobOrder {
    /// Self-supervised pretraining.
    Pretrain {
        /// What to learn from; `None` takes a new snapshot under `rule`.
        snapshot_id: Option<SnapshotId>,
        /// Roles in a new snapshot.
        rule: RoleRule,
        /// Everything else.
        spec: PretrainSpec,
    },
    /// Quality scores.
    Score {
        /// Whose features are compared; `None` only with `extends`, for that run's.
        encoder_id: Option<EncoderId>,
        /// What to score; `None` takes the encoder's own.
        snapshot_id: Option<SnapshotId>,
        /// A finished run to go on from.
        extends: Option<ScoreRunId>,
        /// Everything else.
        spec: ScoreSpec,
    },
    /// Weighted behaviour cloning.
    Train {
        /// What to train on.
        data: TrainData,
        /// Everything else.
        spec: TrainSpec,
    },
    /// Files from a dataset.
    Export {
        /// What to export.
        dataset_id: DatasetId,
    },
    /// Closed-loop trials in the embedded simulator.
    Evaluate {
        /// What to evaluate.
        subject: Subject,
        /// Everything else; an empty simulation is the task's own name.
        spec: EvaluateSpec,
    },
}

/// What one would order to have the same done again: with the same inputs, of which none is chosen anew.
impl From<JobSpec> for JobOrder {
    fn from(spec: JobSpec) -> Self {
        match spec {
            JobSpec::Pretrain { snapshot_id, spec } => {
                Self::Pretrain { snapshot_id: Some(snapshot_id), rule: RoleRule::default(), spec }
            }
            JobSpec::Score { encoder_id, snapshot_id, extends, spec } => {
                Self::Score { encoder_id: Some(encoder_id), snapshot_id: Some(snapshot_id), extends, spec }
            }
            JobSpec::Train { encoder_id, snapshot_id, dataset_id, spec } => {
                let data = match (dataset_id, encoder_id) {
                    (Some(dataset), _) => TrainData::Dataset(dataset),
                    (None, Some(encoder)) => TrainData::ExpertsOf(encoder),
                    (None, None) => TrainData::ExpertsIn(snapshot_id),
                };
                Self::Train { data, spec }
            }
            JobSpec::Export { dataset_id } => Self::Export { dataset_id },
            JobSpec::Evaluate { policy_id, spec } => Self::Evaluate { subject: Subject::Policy(policy_id), spec },
        }
    }
}

/// Which policy is evaluated.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Subject {
    /// This one.
    Policy(PolicyId),
    /// The one that this name points at when the job is submitted.
    Deployment(String),
}

/// What a policy is trained on.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TrainData {
    /// Experts and the kept segments of a dataset.
    Dataset(DatasetId),
    /// The experts of an encoder's snapshot alone.
    ExpertsOf(EncoderId),
    /// The experts of a snapshot alone, for policies that begin from scratch.
    ExpertsIn(SnapshotId),
}

/// Whether the policy of a training starts from a pretrained encoder.
pub fn needs_encoder(spec: &TrainSpec) -> bool {
    Family::Policy.find(&spec.policy.name).is_some_and(|kind| kind.needs.encoder)
}

/// How an ordered job is queued.
#[derive(Debug, Clone, Default)]
pub struct Queueing {
    /// Higher runs first.
    pub priority: i32,
    /// Jobs to wait for, besides those that make its inputs.
    pub needs: Vec<JobId>,
    /// How many attempts it gets; `None` takes the default.
    pub max_attempts: Option<u32>,
    /// The caller's own name for the work, or empty. One key is one job, unless that failed or was cancelled.
    pub key: String,
}

/// A job that is about to be queued.
#[derive(Debug, Clone)]
pub struct NewJob {
    /// Its id.
    pub id: JobId,
    /// Its task.
    pub task_id: TaskId,
    /// What to do, complete.
    pub spec: JobSpec,
    /// The id its result will have.
    pub result_id: String,
    /// Higher runs first.
    pub priority: i32,
    /// How many attempts it gets, at least 1.
    pub max_attempts: u32,
    /// The jobs it waits for.
    pub needs: Vec<JobId>,
    /// The caller's own name for it and what was asked for under that name, if it has one.
    pub keyed: Option<Keyed>,
}

/// A caller's own name for a job.
#[derive(Debug, Clone, PartialEq)]
pub struct Keyed {
    /// The name.
    pub key: String,
    /// What was asked for: the same key must mean the same order.
    pub order: JobOrder,
}

/// Jobs that are queued together, or not at all.
#[derive(Debug, Clone, Default)]
pub struct Plan {
    /// In an order in which each comes after those it waits for.
    pub jobs: Vec<NewJob>,
    /// Datasets between scoring and training.
    pub datasets: Vec<Dataset>,
    /// The schedule that moves on by this.
    pub start: Option<ScheduleStart>,
    /// Refused when a job of the task that has not ended is to do the very same as the first of these.
    pub once: bool,
}

/// Which jobs are meant.
#[derive(Debug, Clone, Default)]
pub struct JobFilter {
    /// Only this task's.
    pub task_id: Option<TaskId>,
    /// Only in this state.
    pub state: Option<JobState>,
    /// Only of this kind.
    pub kind: Option<JobKind>,
}
