//! Submission of a chain of jobs, once also over a broken connection.

use gleaner_core::id::unique;
use gleaner_proto::v1::{SubmitPipelineRequest, SubmitPipelineResponse};

use crate::connection::Client;
use crate::error::{ClientError, Result};
use crate::retry::Backoff;

impl Client {
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
        let mut backoff = Backoff::new();
        loop {
            match self.jobs().submit_pipeline(request.clone()).await.map_err(ClientError::from) {
                Err(error) if error.is_transient() => match backoff.next_wait() {
                    Some(wait) => tokio::time::sleep(wait).await,
                    None => return Err(error),
                },
                Err(error) => return Err(error),
                Ok(reply) => return Ok(reply.into_inner()),
            }
        }
    }
}

#[cfg(test)]
mod tests;
