//! Policies and the names they are deployed under.

use super::{
    id::{BlobId, DatasetId, EncoderId, JobId, PolicyId, ScoreRunId, TaskId},
    time::Millis,
};

/// A trained policy.
#[derive(Debug, Clone)]
pub struct Policy {
    /// Its id.
    pub id: PolicyId,
    /// Its task.
    pub task_id: TaskId,
    /// The job that made it.
    pub job_id: JobId,
    /// For example `finetune`.
    pub kind: String,
    /// The encoder it began from; `None` when it began from scratch.
    pub encoder_id: Option<EncoderId>,
    /// What it was trained on besides experts; `None` for experts alone.
    pub dataset_id: Option<DatasetId>,
    /// Blob of its checkpoint.
    pub checkpoint: BlobId,
    /// When it was finished.
    pub created_at: Millis,
}

/// What a name pointed at from some time on.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DeploymentChange {
    /// The policy that acts.
    pub policy_id: PolicyId,
    /// The run that scores what it does, if any.
    pub score_run_id: Option<ScoreRunId>,
    /// From when on.
    pub since: Millis,
}

/// A name that points at a policy, with history (oldest first, never empty).
#[derive(Debug, Clone)]
pub struct Deployment {
    /// The name robots use.
    pub name: String,
    /// The task all its policies share.
    pub task_id: TaskId,
    /// What it pointed at; the last one is in force.
    pub history: Vec<DeploymentChange>,
}

impl Deployment {
    /// The policy in force.
    pub fn policy_id(&self) -> Option<&PolicyId> {
        self.history.last().map(|change| &change.policy_id)
    }

    /// The score run in force: what its sessions are scored by.
    pub fn score_run_id(&self) -> Option<&ScoreRunId> {
        self.history.last().and_then(|change| change.score_run_id.as_ref())
    }
}
