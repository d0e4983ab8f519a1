//! Orders: what a caller asks for, before the server has chosen inputs and ids.

use gleaner_learn::{PretrainSpec, ScoreSpec, TrainSpec};

use super::{
    dataset::Dataset,
    id::{DatasetId, EncoderId, JobId, SnapshotId, TaskId},
    job::{JobSpec, JobState},
    schedule::ScheduleStart,
    snapshot::RoleRule,
};

/// What a caller asks a job to do. What is left out the server chooses.
#[derive(Debug, Clone, PartialEq)]
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
        /// Whose features are compared.
        encoder_id: EncoderId,
        /// What to score; `None` takes the encoder's own.
        snapshot_id: Option<SnapshotId>,
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
}

/// What a policy is trained on.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum TrainData {
    /// Experts and the kept segments of a dataset.
    Dataset(DatasetId),
    /// The experts of an encoder's snapshot alone.
    ExpertsOf(EncoderId),
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
}

/// Jobs that are queued together, or not at all.
#[derive(Debug, Clone, Default)]
pub struct Plan {
    /// In an order in which each comes after those it waits for.
    pub jobs: Vec<NewJob>,
    /// The dataset between scoring and training.
    pub dataset: Option<Dataset>,
    /// The schedule that moves on by this.
    pub start: Option<ScheduleStart>,
}

/// Which jobs are meant.
#[derive(Debug, Clone, Default)]
pub struct JobFilter {
    /// Only this task's.
    pub task_id: Option<TaskId>,
    /// Only in this state.
    pub state: Option<JobState>,
}
