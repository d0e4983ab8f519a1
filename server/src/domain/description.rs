//! What a sidecar says of the row that stands on a blob: enough to make the row again when the database is lost.

use gleaner_recording::{Report, TaskSpec};
use serde::{Deserialize, Serialize};

use super::{
    episode::{Episode, InspectedEpisode, Outcome},
    id::{BlobId, EncoderId, EpisodeId, JobId, PolicyId, TaskId},
    task::Task,
    time::Millis,
};
use crate::error::{Error, Result};

/// The description of one row. Fields are only ever added, so that a newer program reads what an older one wrote.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub(crate) enum Description {
    /// A task, which stands on no blob.
    Task { id: TaskId, spec: Box<TaskSpec>, created_at: Millis },
    /// An episode on its recording.
    Recording(Box<Recording>),
    /// An encoder on its checkpoint. Its job and its snapshot are lost with the database.
    Encoder { id: EncoderId, task_id: TaskId, job_id: JobId, created_at: Millis },
    /// A policy on its checkpoint. Its job is lost with the database.
    Policy { id: PolicyId, task_id: TaskId, job_id: JobId, policy: String, created_at: Millis },
}

/// An episode with its present label and its report.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Recording {
    pub(crate) id: EpisodeId,
    pub(crate) task_id: TaskId,
    pub(crate) file_name: String,
    pub(crate) recording: BlobId,
    pub(crate) size_bytes: u64,
    pub(crate) steps: u64,
    pub(crate) duration_s: f64,
    pub(crate) mapping: String,
    pub(crate) warnings: u64,
    pub(crate) outcome: Outcome,
    pub(crate) cohort: String,
    /// Author of the label.
    pub(crate) author: String,
    pub(crate) created_at: Millis,
    /// Since when a person has had it in the trash, if so.
    pub(crate) deleted_at: Option<Millis>,
    pub(crate) report: Report,
}

impl Description {
    /// Describes an episode, labelled by `author`.
    pub(crate) fn recording(inspected: &InspectedEpisode, author: &str) -> Self {
        let InspectedEpisode { episode, report } = inspected.clone();
        let Episode { id, task_id, file_name, recording, size_bytes, steps, duration_s, mapping, warnings, .. } =
            episode;
        let Episode { outcome, cohort, created_at, deleted_at, .. } = inspected.episode.clone();
        let author = author.to_owned();
        Self::Recording(Box::new(Recording {
            id,
            task_id,
            file_name,
            recording,
            size_bytes,
            steps,
            duration_s,
            mapping,
            warnings,
            outcome,
            cohort,
            author,
            created_at,
            deleted_at,
            report,
        }))
    }

    /// Describes a task.
    pub(crate) fn task(task: &Task) -> Self {
        Self::Task { id: task.id.clone(), spec: Box::new(task.spec.clone()), created_at: task.created_at }
    }

    /// The description as the content of a sidecar.
    ///
    /// # Errors
    /// Internal; it never happens with values that came from JSON.
    pub(crate) fn to_json(&self) -> Result<Vec<u8>> {
        serde_json::to_vec(self).map_err(|error| Error::internal("describing a row", error))
    }

    /// Reads a sidecar; `None` when it was damaged, or written by a newer program.
    pub(crate) fn read(json: &[u8]) -> Option<Self> {
        serde_json::from_slice(json).ok()
    }

    /// Whether this is an acknowledged recording that no person has deleted.
    pub(crate) fn must_stay(&self) -> bool {
        matches!(self, Self::Recording(recording) if recording.deleted_at.is_none())
    }

    /// Whether this is a recording that a person has deleted.
    pub(crate) fn is_deleted_recording(&self) -> bool {
        matches!(self, Self::Recording(recording) if recording.deleted_at.is_some())
    }
}

impl From<Recording> for InspectedEpisode {
    fn from(described: Recording) -> Self {
        let Recording { id, task_id, file_name, recording, size_bytes, steps, duration_s, mapping, .. } = described;
        let Recording { warnings, outcome, cohort, author: _, created_at, deleted_at, report, .. } = described;
        let episode = Episode {
            id,
            task_id,
            file_name,
            recording,
            size_bytes,
            steps,
            duration_s,
            mapping,
            warnings,
            outcome,
            cohort,
            created_at,
            deleted_at,
        };
        Self { episode, report }
    }
}
