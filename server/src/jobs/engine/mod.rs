//! Engines: the place where a worker of an attempt runs. An engine starts workers, notices their end and kills them.
//! Retries, the leases of attempts and the judgement which process may report are the queue's; must not depend on rows.

mod local;
mod ranks;
mod slurm;

use std::sync::Arc;

use async_trait::async_trait;
use tokio::{io::AsyncRead, sync::watch};

pub(super) use self::{local::Local, slurm::Slurm};
use super::lease::Lease;
use crate::{
    config::Secret,
    domain::{
        attempt::{Attempt, AttemptEnd},
        job::Job,
        placement::Placement,
    },
};

/// The output of a worker on standard error.
pub(super) type Output = Box<dyn AsyncRead + Send + Unpin>;

/// An attempt whose worker is to be started.
pub(super) struct Launch<'a> {
    /// The job, as claimed.
    pub(super) job: &'a Job,
    pub(super) attempt: &'a Attempt,
    /// The credential of the worker.
    pub(super) token: Secret,
    pub(super) lease: &'a Arc<Lease>,
}

/// A place where workers run.
pub(super) trait Engine: Send + Sync {
    /// The word stored in rows.
    fn name(&self) -> &'static str;

    /// Whether workers continue while the server is down.
    fn outlives_server(&self) -> bool;

    /// Whether a job may have options of its own. Those of a job that was queued under another engine are ignored.
    fn takes_options(&self) -> bool;

    /// Starts the worker of an attempt.
    ///
    /// # Errors
    /// The reason, in words.
    fn start(&self, launch: Launch<'_>) -> Result<Box<dyn Execution>, String>;

    /// Resumes watching the worker that an earlier server started at this place; `None` if workers of this engine do not
    /// outlive their server.
    fn resume(&self, attempt: &Attempt, placement: &Placement, lease: &Arc<Lease>) -> Option<Box<dyn Execution>>;
}

/// The worker of one attempt, from its start to its end.
#[async_trait]
pub(super) trait Execution: Send {
    /// Where the worker runs, as it becomes known.
    fn placement(&self) -> watch::Receiver<Placement>;

    /// The output of the worker, once.
    fn output(&mut self) -> Option<Output>;

    /// Waits for the end of a worker that ends on its own, and returns the end of an attempt without a result.
    async fn ended(&mut self) -> End;

    /// Kills the worker, and returns the end of the attempt for this reason.
    async fn kill(&mut self, reason: String) -> End;
}

/// The end of a worker, as the engine sees it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum End {
    /// The worker failed; the attempt counts. Holds the reason.
    Broken(String),
    /// The machine or the cluster ended it; the attempt does not count. Holds the reason.
    Interrupted(String),
    /// A limit on its time or a request from outside ended it; the attempt counts unless it saved a checkpoint, so that it
    /// is not repeated without a limit. Holds the reason.
    Stopped(String),
}

impl End {
    /// The end of the attempt, which did or did not save a checkpoint.
    pub(super) fn of_attempt(self, saved_checkpoint: bool) -> AttemptEnd {
        match self {
            Self::Broken(reason) => AttemptEnd::Broken(reason),
            Self::Interrupted(reason) => AttemptEnd::Interrupted(reason),
            Self::Stopped(reason) if saved_checkpoint => AttemptEnd::Interrupted(reason),
            Self::Stopped(reason) => AttemptEnd::Broken(format!("{reason}, before it saved a checkpoint")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stop_from_outside_counts_only_without_a_checkpoint() {
        let end = End::Stopped("Slurm job 7 reached its time limit".to_owned());
        assert!(matches!(end.clone().of_attempt(true), AttemptEnd::Interrupted(_)));
        let counted = end.of_attempt(false);
        assert!(
            matches!(&counted, AttemptEnd::Broken(why) if why.ends_with("before it saved a checkpoint")),
            "{counted:?}"
        );
        assert!(matches!(End::Interrupted(String::new()).of_attempt(false), AttemptEnd::Interrupted(_)));
    }
}
