//! Results of jobs that have no row: unknown, pending or failed.

use super::Store;
use crate::{
    domain::job::{Job, JobKind, JobState},
    error::{Error, Result},
};

impl Store {
    /// The error for a result that has no row: unknown, not finished, or failed.
    pub(super) async fn missing(&self, kind: JobKind, what: &str, id: &str) -> Error {
        match self.maker(kind, what, id).await {
            Err(error) => error,
            Ok(job) => Error::precondition(format!(
                "{what} {id} is not finished: {} is {}; watch that job",
                job.id,
                job.state.as_str()
            )),
        }
    }

    /// The job of this kind that made or may still make a result.
    ///
    /// # Errors
    /// NotFound; Precondition when the job failed.
    pub(super) async fn maker(&self, kind: JobKind, what: &str, id: &str) -> Result<Job> {
        let job = self.job_of_result(id).await?.filter(|job| job.spec.kind() == kind);
        let job = job.ok_or_else(|| Error::not_found(what, id))?;
        match job.state {
            JobState::Failed => Err(Error::precondition(format!(
                "{what} {id} does not exist: {} failed: {}; submit that job again",
                job.id, job.error
            ))),
            JobState::Cancelled => Err(Error::precondition(format!(
                "{what} {id} does not exist: {} was cancelled; submit that job again",
                job.id
            ))),
            JobState::Queued | JobState::Running | JobState::Succeeded => Ok(job),
        }
    }
}
