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
    /// The encoder its training started from; `None` when it started from scratch.
    pub encoder_id: Option<EncoderId>,
    /// Its training data besides experts; `None` for experts alone.
    pub dataset_id: Option<DatasetId>,
    /// Blob of its checkpoint.
    pub checkpoint: BlobId,
    /// When it was finished.
    pub created_at: Millis,
}

/// An entry in the history of a deployment.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DeploymentChange {
    /// The policy that acts.
    pub policy_id: PolicyId,
    /// The run whose scorer scores its sessions, if any.
    pub score_run_id: Option<ScoreRunId>,
    /// When the change took effect.
    pub since: Millis,
}

/// A name for a policy, with its history (oldest first, never empty).
#[derive(Debug, Clone)]
pub struct Deployment {
    /// The name robots use.
    pub name: String,
    /// The task all its policies share.
    pub task_id: TaskId,
    /// Changes; the last one is in force.
    pub history: Vec<DeploymentChange>,
}

impl Deployment {
    /// The policy in force.
    pub fn policy_id(&self) -> Option<&PolicyId> {
        self.history.last().map(|change| &change.policy_id)
    }

    /// The score run in force, whose scorer scores the sessions.
    pub fn score_run_id(&self) -> Option<&ScoreRunId> {
        self.history.last().and_then(|change| change.score_run_id.as_ref())
    }
}
