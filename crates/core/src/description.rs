//! Content of a sidecar: enough of a blob's row to restore it when the database is lost.

use crate::{Report, TaskSpec};
use serde::{Deserialize, Serialize};

use super::{
    episode::{Episode, InspectedEpisode},
    id::{EncoderId, JobId, PolicyId, TaskId},
    task::Task,
    time::Millis,
};
use crate::error::{Error, Result};

/// The description of one row. Fields are only ever added, so that a newer program reads what an older one wrote.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
#[expect(missing_docs, reason = "the fields are those of the row that each variant describes")]
pub enum Description {
    /// A task, which belongs to no blob.
    Task { id: TaskId, spec: Box<TaskSpec>, created_at: Millis },
    /// An episode, beside its recording.
    Recording(Box<Recording>),
    /// An encoder, beside its checkpoint. Its job and its snapshot are lost with the database.
    Encoder { id: EncoderId, task_id: TaskId, job_id: JobId, created_at: Millis },
    /// A policy, beside its checkpoint. Its job is lost with the database.
    Policy { id: PolicyId, task_id: TaskId, job_id: JobId, policy: String, created_at: Millis },
}

/// An episode with its report and the author of its label. The fields of [`Episode`] are those of the sidecar: they may get
/// new ones with defaults, and lose none.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Recording {
    #[serde(flatten)]
    /// The episode.
    pub episode: Episode,
    /// The author of its label.
    pub author: String,
    /// The report of its inspection.
    pub report: Report,
}

impl Description {
    /// Describes an episode, labelled by `author`.
    pub fn recording(inspected: &InspectedEpisode, author: &str) -> Self {
        let InspectedEpisode { episode, report } = inspected.clone();
        Self::Recording(Box::new(Recording { episode, author: author.to_owned(), report }))
    }

    /// Describes a task.
    pub fn task(task: &Task) -> Self {
        Self::Task { id: task.id.clone(), spec: Box::new(task.spec.clone()), created_at: task.created_at }
    }

    /// The description as the content of a sidecar.
    ///
    /// # Errors
    /// Internal; impossible for values that were read from JSON.
    pub fn to_json(&self) -> Result<Vec<u8>> {
        serde_json::to_vec(self).map_err(|error| Error::internal("describing a row", error))
    }

    /// Reads a sidecar; `None` when it was damaged, or written by a newer program.
    pub fn read(json: &[u8]) -> Option<Self> {
        serde_json::from_slice(json).ok()
    }

    /// Whether this is a recording that a user has deleted.
    pub fn is_deleted_recording(&self) -> bool {
        matches!(self, Self::Recording(recording) if recording.episode.deleted_at.is_some())
    }
}
