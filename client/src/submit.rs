//! Submission of a job or a chain of jobs, once also over a broken connection.

use gleaner_core::id::unique;
use gleaner_proto::v1::{Job, SubmitJobRequest, SubmitPipelineRequest, SubmitPipelineResponse};

use crate::connection::Client;
use crate::error::{ClientError, Result};
use crate::retry::patiently;

impl Client {
    /// Queues a job. A request without a key gets one of its own, so that a repeat after a lost response returns the job of
    /// the first call instead of a second one.
    ///
    /// # Errors
    /// [`ClientError::Rejected`] with the server's reason (the codes of `SubmitJob`), or the last error once retries are
    /// exhausted.
    pub async fn submit_job(&self, mut request: SubmitJobRequest) -> Result<Job> {
        if request.key.is_empty() {
            request.key = format!("job/{}", unique());
        }
        let reply = patiently(async || Ok(self.jobs().submit_job(request.clone()).await?)).await?;
        reply.into_inner().job.ok_or(ClientError::Contract { missing: "a job" })
    }

    /// Queues a chain of jobs. A request without a key gets one of its own, so that a repeat after a lost response returns
    /// the chain of the first instead of a second one.
    ///
    /// # Errors
    /// [`ClientError::Rejected`] with the server's reason (the codes of `SubmitPipeline`), or the last error once retries
    /// are exhausted.
    pub async fn submit_pipeline(&self, mut request: SubmitPipelineRequest) -> Result<SubmitPipelineResponse> {
        if request.key.is_empty() {
            request.key = format!("pipeline/{}", unique());
        }
        let reply = patiently(async || Ok(self.jobs().submit_pipeline(request.clone()).await?)).await?;
        Ok(reply.into_inner())
    }
}

#[cfg(test)]
mod tests;
