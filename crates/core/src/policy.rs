//! Policies and the names they are deployed under.

use super::{
    error::Error,
    id::{BlobId, DatasetId, EncoderId, JobId, PolicyId, ScoreRunId, TaskId},
    remote::RemotePolicy,
    time::Millis,
};

pub use super::remote::KIND as REMOTE;

/// A policy: trained here, or run by another server.
#[derive(Debug, Clone)]
pub struct Policy {
    /// Its id.
    pub id: PolicyId,
    /// Its task.
    pub task_id: TaskId,
    /// For example `finetune`; [`REMOTE`] for a policy that another server runs.
    pub kind: String,
    /// Where it comes from.
    pub origin: PolicyOrigin,
    /// When it was finished, or registered.
    pub created_at: Millis,
}

/// Where a policy comes from.
#[derive(Debug, Clone)]
pub enum PolicyOrigin {
    /// A training of this server.
    Trained(Training),
    /// Another server, which runs it.
    Remote(Box<RemotePolicy>),
}

/// The training of a policy.
#[derive(Debug, Clone)]
pub struct Training {
    /// The job that made it.
    pub job_id: JobId,
    /// The encoder its training started from; `None` when it started from scratch.
    pub encoder_id: Option<EncoderId>,
    /// Its training data besides experts; `None` for experts alone.
    pub dataset_id: Option<DatasetId>,
    /// Blob of its checkpoint.
    pub checkpoint: BlobId,
}

impl Policy {
    /// Its training; `None` for a policy that another server runs.
    #[must_use]
    pub fn training(&self) -> Option<&Training> {
        match &self.origin {
            PolicyOrigin::Trained(training) => Some(training),
            PolicyOrigin::Remote(_) => None,
        }
    }

    /// The server that runs it; `None` for a policy that was trained here.
    #[must_use]
    pub fn remote(&self) -> Option<&RemotePolicy> {
        match &self.origin {
            PolicyOrigin::Trained(_) => None,
            PolicyOrigin::Remote(remote) => Some(remote),
        }
    }

    /// The job that made it, if it was trained here.
    #[must_use]
    pub fn job_id(&self) -> Option<&JobId> {
        self.training().map(|training| &training.job_id)
    }
}

/// The refusal to hide the history of a policy that has none.
pub fn no_history(field: &str, policy: &impl std::fmt::Display) -> Error {
    Error::invalid(
        field,
        format!("needs a policy with a history: {policy} acts on the newest step alone; leave it out"),
    )
}

/// What a deployment's name points at.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Assignment {
    /// The policy that acts.
    pub policy_id: PolicyId,
    /// The run whose scorer scores its sessions, if any.
    pub score_run_id: Option<ScoreRunId>,
    /// Whether the policy's history is hidden, as it was at times in training.
    pub hide_history: bool,
}

impl Assignment {
    /// The policy alone, with its history shown.
    #[must_use]
    pub fn of(policy: &PolicyId) -> Self {
        Self { policy_id: policy.clone(), score_run_id: None, hide_history: false }
    }
}

/// An entry in the history of a deployment.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DeploymentChange {
    /// What the name points at since then.
    pub assignment: Assignment,
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
    /// What is in force.
    pub fn assignment(&self) -> Option<&Assignment> {
        self.history.last().map(|change| &change.assignment)
    }

    /// The policy in force.
    pub fn policy_id(&self) -> Option<&PolicyId> {
        self.assignment().map(|now| &now.policy_id)
    }

    /// The score run in force, whose scorer scores the sessions.
    pub fn score_run_id(&self) -> Option<&ScoreRunId> {
        self.assignment().and_then(|now| now.score_run_id.as_ref())
    }
}
