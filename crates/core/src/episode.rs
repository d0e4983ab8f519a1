//! Episodes and their labels.

use super::{
    client::Client,
    id::{BlobId, EpisodeId, TaskId, UploadId},
    time::{Millis, seconds},
};
use crate::{RecordingSummary, Report, Severity};

/// Outcome of an attempt at the task.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// The task was completed.
    Success,
    /// The task was not completed.
    Failure,
    /// No outcome was given.
    Unknown,
}

impl Outcome {
    /// The word stored in rows.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Success => "success",
            Self::Failure => "failure",
            Self::Unknown => "unknown",
        }
    }

    /// Reads the word stored in rows.
    pub fn from_word(word: &str) -> Option<Self> {
        [Self::Success, Self::Failure, Self::Unknown].into_iter().find(|outcome| outcome.as_str() == word)
    }
}

/// One attempt at a task: an immutable recording with a label.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Episode {
    /// Its id.
    pub id: EpisodeId,
    /// The task it attempts.
    pub task_id: TaskId,
    /// The name it was uploaded under; for people only, never a path.
    pub file_name: String,
    /// The blob that holds the MCAP.
    pub recording: BlobId,
    /// Size of the recording in bytes.
    pub size_bytes: u64,
    /// T, the number of aligned steps.
    pub steps: u64,
    /// Time from the first step to the last, in seconds.
    pub duration_s: f64,
    /// The task's mapping that was used.
    pub mapping: String,
    /// Number of findings of its report that are warnings.
    pub warnings: u64,
    /// Its present label.
    pub outcome: Outcome,
    /// Free-form tag of where it comes from.
    pub cohort: String,
    /// When it became visible.
    pub created_at: Millis,
    /// When it was moved to the trash; `None`: it is not there.
    pub deleted_at: Option<Millis>,
}

/// An episode with the report of its inspection.
#[derive(Debug, Clone)]
pub struct InspectedEpisode {
    /// The episode.
    pub episode: Episode,
    /// The report of its inspection.
    pub report: Report,
}

/// A label: an outcome with its author, time and reason.
#[derive(Debug, Clone)]
pub struct Label {
    /// Outcome of the episode.
    pub outcome: Outcome,
    /// The cohort at the time of this label.
    pub cohort: String,
    /// The author.
    pub author: String,
    /// Reason; may be empty.
    pub reason: String,
    /// When the label was made.
    pub created_at: Millis,
}

/// A label to be given to episodes.
#[derive(Debug, Clone)]
pub struct NewLabel {
    /// Outcome of the episodes; `None` keeps each one's own.
    pub outcome: Option<Outcome>,
    /// Their cohort; `None` keeps each one's own.
    pub cohort: Option<String>,
    /// The author.
    pub author: String,
    /// Reason; may be empty.
    pub reason: String,
}

/// Filter of a task's episodes.
#[derive(Debug, Clone)]
pub struct EpisodeFilter {
    /// The task.
    pub task_id: TaskId,
    /// Only with this outcome.
    pub outcome: Option<Outcome>,
    /// Only of this cohort.
    pub cohort: Option<String>,
    /// Only episodes in the trash; otherwise only episodes outside it.
    pub deleted: bool,
}

/// A client's declaration of a recording before it is sent.
#[derive(Debug, Clone)]
pub struct NewUpload {
    /// The task it is for.
    pub task_id: TaskId,
    /// The name the episode will have.
    pub file_name: String,
    /// Size in bytes.
    pub size_bytes: u64,
    /// Digest of the content.
    pub blake3: BlobId,
    /// The label the episode will have.
    pub outcome: Outcome,
    /// The cohort the episode will have.
    pub cohort: String,
    /// The author of the label.
    pub author: String,
    /// The client that the upload and its inspection are counted for.
    pub client: Client,
    /// What the recording states about itself, if the client read it.
    pub summary: Option<RecordingSummary>,
}

/// An upload that is not finished.
#[derive(Debug, Clone)]
pub struct Upload {
    /// Its id.
    pub id: UploadId,
    /// The task it is for.
    pub task_id: TaskId,
    /// The name the episode will have.
    pub file_name: String,
    /// Declared size in bytes.
    pub size_bytes: u64,
    /// Declared digest.
    pub blake3: BlobId,
    /// Bytes that are synced to disk. Never falls.
    pub committed: u64,
    /// The label the episode will have.
    pub outcome: Outcome,
    /// The cohort the episode will have.
    pub cohort: String,
    /// The author of the label.
    pub author: String,
    /// The client that opened the upload; its inspection is counted for the same client.
    pub client: Client,
}

impl NewUpload {
    /// The open upload of this declaration, under a new id and without content.
    pub fn open(self) -> Upload {
        let Self { task_id, file_name, size_bytes, blake3, outcome, cohort, author, client, summary: _ } = self;
        let id = UploadId::new();
        Upload { id, task_id, file_name, size_bytes, blake3, committed: 0, outcome, cohort, author, client }
    }
}

impl Upload {
    /// Whether the bytes sent for one upload may serve for the other: equal content and label.
    pub fn is_like(&self, other: &Self) -> bool {
        self.size_bytes == other.size_bytes && self.outcome == other.outcome && self.cohort == other.cohort
    }

    /// The episode that the finished upload becomes, given the report of its inspection.
    pub fn become_episode(&self, report: &Report) -> Episode {
        let warnings = report.findings.iter().filter(|f| f.severity == Severity::Warning).count();
        Episode {
            id: EpisodeId::new(),
            task_id: self.task_id.clone(),
            file_name: self.file_name.clone(),
            recording: self.blake3.clone(),
            size_bytes: self.size_bytes,
            steps: report.steps,
            duration_s: seconds(report.duration_ns),
            mapping: report.mapping.clone(),
            warnings: warnings as u64,
            outcome: self.outcome,
            cohort: self.cohort.clone(),
            created_at: Millis::now(),
            deleted_at: None,
        }
    }
}
