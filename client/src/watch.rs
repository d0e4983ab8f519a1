//! Watch: a job's changes and metrics as they arrive, across broken connections, until it ends.

use gleaner_proto::v1::{Job, JobState, WatchJobRequest, WatchJobResponse};

use crate::connection::Client;
use crate::error::{ClientError, Result};
use crate::retry::Backoff;

/// Whether a job in this state will never change again.
#[must_use]
pub fn has_ended(state: JobState) -> bool {
    match state {
        JobState::Succeeded | JobState::Failed | JobState::Cancelled => true,
        JobState::Unspecified | JobState::Queued | JobState::Running => false,
    }
}

impl Client {
    /// Follows a job until it ends and returns it. Each event carries the current job and its new metrics. A broken
    /// connection is reopened, after which metrics may repeat.
    ///
    /// # Errors
    /// [`ClientError::Rejected`] when there is no such job, or the last error once retries are exhausted.
    pub async fn watch(&self, job_id: &str, mut on_event: impl FnMut(&WatchJobResponse)) -> Result<Job> {
        let mut backoff = Backoff::new();
        loop {
            let error = match self.watch_once(job_id, &mut on_event, &mut backoff).await {
                Ok(Some(job)) => return Ok(job),
                // The stream ended before the job: the server is stopping.
                Ok(None) => ClientError::Contract { missing: "the job's end" },
                Err(error) if error.is_transient() => error,
                Err(error) => return Err(error),
            };
            match backoff.next_wait() {
                Some(wait) => tokio::time::sleep(wait).await,
                None => return Err(error),
            }
        }
    }

    /// As [`Client::watch`], with an error unless the job succeeds.
    ///
    /// # Errors
    /// [`ClientError::JobEnded`] when it failed or was cancelled; else as for [`Client::watch`].
    pub async fn wait(&self, job_id: &str, on_event: impl FnMut(&WatchJobResponse)) -> Result<Job> {
        let job = self.watch(job_id, on_event).await?;
        if job.state() == JobState::Succeeded { Ok(job) } else { Err(ClientError::JobEnded(Box::new(job))) }
    }

    async fn watch_once(
        &self,
        job_id: &str,
        on_event: &mut impl FnMut(&WatchJobResponse),
        backoff: &mut Backoff,
    ) -> Result<Option<Job>> {
        let request = WatchJobRequest { job_id: job_id.to_owned() };
        let mut events = self.jobs().watch_job(request).await?.into_inner();
        let mut last = None;
        while let Some(event) = events.message().await? {
            backoff.restore();
            on_event(&event);
            last = event.job.or(last);
        }
        Ok(last.filter(|job| has_ended(job.state())))
    }
}
