//! Schedules: pipelines that start by themselves.

use gleaner_learn::{PretrainSpec, TrainSpec};

use super::{
    id::{ScheduleId, TaskId},
    snapshot::RoleRule,
    time::Millis,
};

/// A chain of jobs: pretrain, then score, then a dataset at β, then train. Later stages are optional.
#[derive(Debug, Clone, serde::Serialize, serde::Deserialize)]
pub struct PipelineSpec {
    /// Which episodes play which role in the snapshot each start takes.
    pub rule: RoleRule,
    /// The first stage.
    pub pretrain: PretrainSpec,
    /// Whether to score.
    pub score: bool,
    /// Makes a dataset; needs `score`.
    pub beta: Option<f64>,
    /// Trains a policy on it; needs `beta`.
    pub train: Option<TrainSpec>,
}

/// What starts a schedule.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Trigger {
    /// A cron expression of five fields, in UTC.
    Cron(String),
    /// So many newly labelled episodes of the task.
    LabelledEpisodes(u32),
}

/// A pipeline with what starts it.
#[derive(Debug, Clone)]
pub struct Schedule {
    /// Its id.
    pub id: ScheduleId,
    /// Its task.
    pub task_id: TaskId,
    /// Its name, unique within the task.
    pub name: String,
    /// What starts it.
    pub trigger: Trigger,
    /// What is started.
    pub pipeline: PipelineSpec,
    /// Whether it stands still.
    pub paused: bool,
    /// When cron starts it next.
    pub next_run_at: Option<Millis>,
    /// When it last started.
    pub last_run_at: Option<Millis>,
    /// The newest label already counted.
    pub label_mark: i64,
    /// Why the last start failed; empty when it did not.
    pub last_error: String,
}
