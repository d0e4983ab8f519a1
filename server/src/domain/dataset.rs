//! Datasets: a score run seen through a threshold; exports: files made from one.

use super::{
    id::{BlobId, DatasetId, ScoreRunId, TaskId},
    time::Millis,
};

/// A filtered, weighted view of a score run. Never a copy.
#[derive(Debug, Clone)]
pub struct Dataset {
    /// Its id.
    pub id: DatasetId,
    /// Its task.
    pub task_id: TaskId,
    /// The run it filters; may not be finished yet.
    pub score_run_id: ScoreRunId,
    /// q > β is kept.
    pub beta: f64,
    /// When it was made.
    pub created_at: Millis,
}

/// One file of an export.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ExportFile {
    /// Its name within the export.
    pub name: String,
    /// The blob that holds it.
    pub blob: BlobId,
    /// Its size in bytes.
    pub size_bytes: u64,
}
