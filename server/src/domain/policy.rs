//! Policies and the names they are deployed under.

use super::{
    id::{BlobId, DatasetId, EncoderId, JobId, PolicyId, TaskId},
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

/// A name that points at a policy, with history (oldest first, never empty).
#[derive(Debug, Clone)]
pub struct Deployment {
    /// The name robots use.
    pub name: String,
    /// The task all its policies share.
    pub task_id: TaskId,
    /// What it pointed at, and from when on; the last one is in force.
    pub history: Vec<(PolicyId, Millis)>,
}

impl Deployment {
    /// The policy in force.
    pub fn policy_id(&self) -> Option<&PolicyId> {
        self.history.last().map(|(policy, _)| policy)
    }
}
