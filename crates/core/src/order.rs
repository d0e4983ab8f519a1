//! Orders: a caller's specification of a job, before the server has chosen inputs and ids.

use crate::{EvaluateSpec, InitialWeights, PretrainSpec, ScoreSpec, TrainSpec, Words as _, kinds::Family};

use super::{
    dataset::{Dataset, ExportSpec},
    id::{DatasetId, EncoderId, JobId, PolicyId, ScoreRunId, SnapshotId, TaskId},
    job::{JobKind, JobSpec, JobState},
    schedule::{PipelineSpec, ScheduleStart},
    snapshot::RoleRule,
};

/// A caller's specification of a job. The server fills in parts that are left out.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum JobOrder {
    /// Self-supervised pretraining.
    Pretrain {
        /// The episodes for pretraining; `None` takes a new snapshot under `rule`.
        snapshot_id: Option<SnapshotId>,
        /// Roles in a new snapshot.
        rule: RoleRule,
        /// The settings.
        spec: PretrainSpec,
    },
    /// Quality scores.
    Score {
        /// The encoder whose features are compared; `None` takes the encoder of the run to extend, or the task's newest, or
        /// an untrained one for a scorer that reads none.
        encoder_id: Option<EncoderId>,
        /// The episodes to score; `None` takes the task's present ones, under the rule of the encoder's snapshot or of the
        /// run to extend.
        snapshot_id: Option<SnapshotId>,
        /// A finished run to extend.
        extends: Option<ScoreRunId>,
        /// The settings.
        spec: ScoreSpec,
    },
    /// Weighted behaviour cloning.
    Train {
        /// The training data.
        data: TrainData,
        /// The settings.
        spec: TrainSpec,
    },
    /// Files from a dataset.
    Export {
        /// The dataset to export.
        dataset_id: DatasetId,
        /// The settings.
        #[serde(default)]
        spec: ExportSpec,
    },
    /// Closed-loop trials in the embedded simulator.
    Evaluate {
        /// The policy to evaluate.
        subject: Subject,
        /// The settings; an empty simulation means the task's own name.
        spec: EvaluateSpec,
    },
}

/// The order that repeats a job with the same inputs, none of which is chosen again.
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
            JobSpec::Export { dataset_id, spec } => Self::Export { dataset_id, spec },
            JobSpec::Evaluate { policy_id, spec } => Self::Evaluate { subject: Subject::Policy(policy_id), spec },
        }
    }
}

/// The policy to evaluate.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Subject {
    /// The policy with this id.
    Policy(PolicyId),
    /// The policy that this deployment points at when the job is submitted.
    Deployment(String),
}

/// The data of a training.
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

/// Whether a training starts from a pretrained encoder.
pub fn needs_encoder(spec: &TrainSpec) -> bool {
    let always = Family::Policy.find(&spec.policy.name).is_some_and(|kind| kind.needs.encoder);
    let begins = spec.policy.settings.get("initial_weights").and_then(|word| word.as_str());
    always || begins == Some(InitialWeights::Encoder.as_str())
}

/// Settings of an ordered job's queueing.
#[derive(Debug, Clone, Default)]
pub struct Queueing {
    /// Jobs with higher values run first.
    pub priority: i32,
    /// Jobs to wait for, in addition to those that make its inputs.
    pub needs: Vec<JobId>,
    /// Most attempts of the job; `None` takes the default.
    pub max_attempts: Option<u32>,
    /// The caller's own name for the work, or empty. One key names one job, unless that job failed or was cancelled.
    pub key: String,
    /// Options of its engine, such as those of sbatch, or empty.
    pub engine_options: String,
}

/// Settings of the queueing of a pipeline's jobs, as in [`Queueing`].
#[derive(Debug, Clone, Default)]
pub struct PipelineQueueing {
    /// Jobs with higher values run first.
    pub priority: i32,
    /// Options of the engine of every job, or empty.
    pub engine_options: String,
    /// The caller's own name for the work, or empty; that of the last job, which ends with every job before it that fails
    /// or is cancelled.
    pub key: String,
}

/// A job to be queued.
#[derive(Debug, Clone)]
pub struct NewJob {
    /// Its id.
    pub id: JobId,
    /// Its task.
    pub task_id: TaskId,
    /// The complete specification.
    pub spec: JobSpec,
    /// The id its result will have.
    pub result_id: String,
    /// Jobs with higher values run first.
    pub priority: i32,
    /// Most attempts of the job, at least 1.
    pub max_attempts: u32,
    /// Options of its engine, or empty.
    pub engine_options: String,
    /// The jobs whose results it waits for.
    pub needs: Vec<JobId>,
    /// The caller's own name for the job and the order given with it, if there is one.
    pub keyed: Option<Keyed>,
}

/// A caller's own name for a job.
#[derive(Debug, Clone, PartialEq)]
pub struct Keyed {
    /// The name.
    pub key: String,
    /// The order given with the name: one key stands for one order.
    pub order: KeyedOrder,
}

/// What a key stands for; stored with the job that has the key.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(untagged)]
pub enum KeyedOrder {
    /// One job.
    Job(Box<JobOrder>),
    /// A chain of jobs, of which the last one has the key.
    Pipeline {
        /// The chain, as its caller sent it.
        pipeline: Box<PipelineSpec>,
    },
}

/// Jobs that are queued in one transaction.
#[derive(Debug, Clone, Default)]
pub struct Plan {
    /// Each job comes after those it waits for.
    pub jobs: Vec<NewJob>,
    /// Datasets between scoring and training.
    pub datasets: Vec<Dataset>,
    /// The start of the schedule that this plan belongs to, if any.
    pub start: Option<ScheduleStart>,
    /// Whether the plan is rejected while an unfinished job of the task has the same specification as its first job.
    pub once: bool,
}

/// Filter of jobs.
#[derive(Debug, Clone, Default)]
pub struct JobFilter {
    /// Only this task's.
    pub task_id: Option<TaskId>,
    /// Only in this state.
    pub state: Option<JobState>,
    /// Only of this kind.
    pub kind: Option<JobKind>,
}
