//! Jobs: their kinds, specs and legal transitions.

mod metric;

use crate::{EvaluateSpec, ImageWeights, PretrainSpec, Problem, ScoreSpec, TrainSpec};

use super::{
    dataset::ExportSpec,
    id::{BlobId, DatasetId, EncoderId, JobId, PolicyId, ScoreRunId, SnapshotId, TaskId},
    placement::Placement,
    time::Millis,
};

pub use metric::Metric;

/// The kinds of jobs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum JobKind {
    /// Makes an encoder.
    Pretrain,
    /// Makes a score run.
    Score,
    /// Makes a policy.
    Train,
    /// Makes an export.
    Export,
    /// Makes an evaluation.
    Evaluate,
}

impl JobKind {
    /// Every kind.
    pub const ALL: [Self; 5] = [Self::Pretrain, Self::Score, Self::Train, Self::Export, Self::Evaluate];

    /// Reads the word stored in rows.
    pub fn from_word(word: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.as_str() == word)
    }

    /// The word stored in rows.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Pretrain => "pretrain",
            Self::Score => "score",
            Self::Train => "train",
            Self::Export => "export",
            Self::Evaluate => "evaluate",
        }
    }
}

/// State of a job.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum JobState {
    /// Waits for its dependencies or for a worker.
    Queued,
    /// Runs in a worker.
    Running,
    /// Ended with a result.
    Succeeded,
    /// Ended without a result; its error has the reason.
    Failed,
    /// Cancelled by a caller.
    Cancelled,
}

impl JobState {
    /// Every state.
    pub const ALL: [Self; 5] = [Self::Queued, Self::Running, Self::Succeeded, Self::Failed, Self::Cancelled];

    /// The word stored in rows.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Queued => "queued",
            Self::Running => "running",
            Self::Succeeded => "succeeded",
            Self::Failed => "failed",
            Self::Cancelled => "cancelled",
        }
    }

    /// Reads the word stored in rows.
    pub fn from_word(word: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|state| state.as_str() == word)
    }

    /// Whether the state is final.
    pub fn ended(self) -> bool {
        match self {
            Self::Succeeded | Self::Failed | Self::Cancelled => true,
            Self::Queued | Self::Running => false,
        }
    }

    /// Whether a job may change from this state to `next`. A running job becomes queued again for another attempt.
    pub fn may_become(self, next: Self) -> bool {
        match (self, next) {
            (Self::Queued, Self::Running | Self::Cancelled | Self::Failed)
            | (Self::Running, Self::Queued | Self::Succeeded | Self::Failed | Self::Cancelled) => true,
            (Self::Queued, Self::Queued | Self::Succeeded)
            | (Self::Running, Self::Running)
            | (Self::Succeeded | Self::Failed | Self::Cancelled, _) => false,
        }
    }
}

/// The complete description of a job's work, stored in its row as JSON.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum JobSpec {
    /// Self-supervised pretraining on a snapshot.
    Pretrain {
        /// D_u = D_e ∪ D_i.
        snapshot_id: SnapshotId,
        /// The settings.
        spec: PretrainSpec,
    },
    /// Quality scores of a snapshot's imperfect episodes.
    Score {
        /// The encoder whose features are compared.
        encoder_id: EncoderId,
        /// Experts and imperfect episodes.
        snapshot_id: SnapshotId,
        /// The finished run that this one extends, if any.
        #[serde(default)]
        extends: Option<ScoreRunId>,
        /// The settings.
        spec: ScoreSpec,
    },
    /// Weighted behaviour cloning.
    Train {
        /// The encoder that training starts from; `None`: training starts from scratch.
        encoder_id: Option<EncoderId>,
        /// The experts' snapshot.
        snapshot_id: SnapshotId,
        /// Kept segments; `None` for experts alone.
        dataset_id: Option<DatasetId>,
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
        policy_id: PolicyId,
        /// The settings.
        spec: EvaluateSpec,
    },
}

impl JobSpec {
    /// The kind of job that has this spec.
    pub fn kind(&self) -> JobKind {
        match self {
            Self::Pretrain { .. } => JobKind::Pretrain,
            Self::Score { .. } => JobKind::Score,
            Self::Train { .. } => JobKind::Train,
            Self::Export { .. } => JobKind::Export,
            Self::Evaluate { .. } => JobKind::Evaluate,
        }
    }

    /// The file of weights that the image encoder begins with; the default for none.
    ///
    /// # Errors
    /// The setting is not the name of a file; specs that were read before have none such.
    pub fn image_weights(&self) -> Result<ImageWeights, Problem> {
        match self {
            Self::Pretrain { spec, .. } => Ok(spec.image_weights.clone()),
            Self::Train { spec, .. } => spec.image_weights(),
            Self::Score { .. } | Self::Export { .. } | Self::Evaluate { .. } => Ok(ImageWeights::default()),
        }
    }

    /// The same work with this file in place of the one that it names.
    #[must_use]
    pub fn with_image_weights(self, image_weights: ImageWeights) -> Self {
        match self {
            Self::Pretrain { snapshot_id, spec } => {
                Self::Pretrain { snapshot_id, spec: PretrainSpec { image_weights, ..spec } }
            }
            Self::Train { encoder_id, snapshot_id, dataset_id, spec } => {
                Self::Train { encoder_id, snapshot_id, dataset_id, spec: spec.with_image_weights(image_weights) }
            }
            Self::Score { .. } | Self::Export { .. } | Self::Evaluate { .. } => self,
        }
    }

    /// The snapshot that the spec names, if any.
    pub fn snapshot_id(&self) -> Option<&SnapshotId> {
        match self {
            Self::Pretrain { snapshot_id, .. } | Self::Score { snapshot_id, .. } | Self::Train { snapshot_id, .. } => {
                Some(snapshot_id)
            }
            Self::Export { .. } | Self::Evaluate { .. } => None,
        }
    }
}

/// A queued unit of work.
#[derive(Debug, Clone, PartialEq)]
pub struct Job {
    /// Its id.
    pub id: JobId,
    /// Its task.
    pub task_id: TaskId,
    /// Its complete specification.
    pub spec: JobSpec,
    /// Its state.
    pub state: JobState,
    /// Jobs with higher values run first.
    pub priority: i32,
    /// The id its result has or will have (encoder, score run, policy, export or evaluation).
    pub result_id: String,
    /// Progress, out of `total`.
    pub done: u64,
    /// Final value of `done`; 0 while unknown.
    pub total: u64,
    /// Its present activity.
    pub message: String,
    /// Reason for its failure; empty if it did not fail.
    pub error: String,
    /// Number of the present attempt; 0 before the first.
    pub attempt: u32,
    /// Most attempts of the job.
    pub max_attempts: u32,
    /// Whether a cancellation was requested.
    pub cancel_requested: bool,
    /// Blob to resume from.
    pub checkpoint: Option<BlobId>,
    /// The step after which that blob was written.
    pub checkpoint_step: Option<u64>,
    /// Most memory its worker has held, in bytes.
    pub peak_memory_bytes: u64,
    /// Where its newest attempt runs or ran.
    pub placement: Placement,
    /// The jobs whose results it needs.
    pub needs: Vec<JobId>,
    /// While it is queued, those of them that have not ended.
    pub waits_for: Vec<JobId>,
    /// The caller's own name for it, or empty.
    pub key: String,
    /// Options of its engine, such as those of sbatch, or empty.
    pub engine_options: String,
    /// When it was submitted.
    pub created_at: Millis,
    /// When its newest attempt began.
    pub started_at: Option<Millis>,
    /// When it ended.
    pub ended_at: Option<Millis>,
}

impl Job {
    /// Why a queued job, or an attempt that its engine has not started, waits; empty if it does not.
    pub fn waiting(&self) -> String {
        match (self.state, self.placement.waiting.as_str(), self.waits_for.as_slice()) {
            (JobState::Queued, "", []) => "for a free worker".to_owned(),
            (JobState::Queued, "", [one]) => format!("for {one}, whose result it needs"),
            (JobState::Queued, "", [first, rest @ ..]) => {
                format!("for {first} and {} more, whose results it needs", rest.len())
            }
            (_, known, _) => known.to_owned(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_ended_job_does_not_change_its_state() {
        for state in JobState::ALL {
            for next in JobState::ALL {
                if state.ended() {
                    assert!(!state.may_become(next), "{state:?} became {next:?}");
                }
            }
            assert_eq!(JobState::from_word(state.as_str()), Some(state));
        }
        for kind in JobKind::ALL {
            assert_eq!(JobKind::from_word(kind.as_str()), Some(kind));
        }
        assert!(JobState::Running.may_become(JobState::Queued));
        assert!(!JobState::Queued.may_become(JobState::Succeeded));
    }
}
