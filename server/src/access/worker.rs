//! The caller on the workers' listener: the worker of one running attempt of a job, identified by the token of the attempt.

use tonic::codegen::http::HeaderMap;

use super::secret;
use crate::{
    domain::{attempt::Attempt, job::Job},
    error::{Error, Result},
    jobs::Jobs,
};

/// A worker, as the guard has authenticated it.
#[derive(Debug, Clone)]
pub(crate) struct Worker {
    pub(crate) attempt: Attempt,
    pub(crate) job: Job,
}

impl Worker {
    /// The worker that makes a request.
    ///
    /// # Errors
    /// Internal when no guard precedes the service.
    pub(crate) fn of<T>(request: &tonic::Request<T>) -> Result<Self> {
        let worker = request.extensions().get::<Self>().cloned();
        worker.ok_or_else(|| Error::internal("identifying a worker", "no guard precedes this service"))
    }

    /// The worker whose token a request has.
    ///
    /// # Errors
    /// Unauthenticated.
    pub(super) async fn authenticate(jobs: &Jobs, headers: &HeaderMap) -> Result<Self> {
        let not_this_job = || Error::unauthenticated("this call needs the token of a running attempt of a job");
        let token = secret::bearer(headers)?.ok_or_else(not_this_job)?;
        let (attempt, job) = jobs.authenticate(token).await?.ok_or_else(not_this_job)?;
        Ok(Self { attempt, job })
    }
}
