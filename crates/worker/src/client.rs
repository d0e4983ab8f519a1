//! The worker's calls to its server, each with the attempt's token.

use std::time::Duration;

use futures::stream;
use gleaner_proto::v1::{self, worker_service_client::WorkerServiceClient};
use tokio::time::{Instant, sleep};
use tonic::{
    Code, Request, Status,
    metadata::{Ascii, MetadataValue},
    service::{Interceptor, interceptor::InterceptedService},
    transport::{Channel, Endpoint},
};

use crate::config::WorkerConfig;
use gleaner_core::{
    error::{Error, Result},
    id::{BlobId, JobId},
    order::JobOrder,
    proto,
    score::EpisodeScores,
    work::{Inputs, Made, Progress},
};

const CONNECT_TIMEOUT: Duration = Duration::from_secs(10);
/// Time for which a worker retries a call that the server rejects for the moment.
pub(crate) const RETRY_FOR: Duration = Duration::from_secs(600);
const FIRST_PAUSE: Duration = Duration::from_millis(100);
pub(crate) const LONGEST_PAUSE: Duration = Duration::from_secs(5);

/// Adds the token to every call.
#[derive(Clone)]
struct Bearer(MetadataValue<Ascii>);

impl Interceptor for Bearer {
    fn call(&mut self, mut request: Request<()>) -> std::result::Result<Request<()>, Status> {
        request.metadata_mut().insert("authorization", self.0.clone());
        Ok(request)
    }
}

/// The client of one attempt of one job.
pub(crate) struct Client(WorkerServiceClient<InterceptedService<Channel, Bearer>>);

impl Client {
    /// Connects.
    ///
    /// # Errors
    /// Unavailable when the server does not respond.
    pub(crate) async fn connect(config: &WorkerConfig) -> Result<Self> {
        let channel = Endpoint::from_shared(config.server.clone())
            .map_err(|error| Error::invalid("--server", error))?
            .connect_timeout(CONNECT_TIMEOUT)
            .tcp_nodelay(true)
            .connect()
            .await
            .map_err(|error| Error::unavailable(format!("the server {} does not answer: {error}", config.server)))?;
        let mut bearer: MetadataValue<Ascii> = format!("Bearer {}", config.token.reveal())
            .parse()
            .map_err(|_| Error::invalid("GLEANER_JOB_TOKEN", "is not a token"))?;
        bearer.set_sensitive(true);
        let client = WorkerServiceClient::with_interceptor(channel, Bearer(bearer))
            .max_decoding_message_size(config.max_message_bytes)
            .max_encoding_message_size(config.max_message_bytes);
        Ok(Self(client))
    }

    /// The assignment: the job, its order and its inputs with their episodes.
    pub(crate) async fn assignment(&mut self) -> Result<(JobId, JobOrder, Inputs)> {
        let received = match with_retries(async || self.0.get_assignment(v1::GetAssignmentRequest {}).await).await {
            Ok(response) => {
                let (job, order, mut inputs) = proto::worker::assigned(response.into_inner())?;
                self.episodes(&mut inputs).await.map(|()| (job, order, inputs))
            }
            Err(status) => Err(status),
        };
        match received {
            Ok(assignment) => Ok(assignment),
            Err(status) => {
                if status.code() == Code::FailedPrecondition {
                    // Every attempt would get the same error.
                    self.fail(status.message().to_owned(), false).await?;
                }
                Err(refused(status))
            }
        }
    }

    /// Adds the episodes of the inputs. A stream that breaks ends the attempt, and the next one begins it again.
    async fn episodes(&mut self, inputs: &mut Inputs) -> tonic::Result<()> {
        let stream = with_retries(async || self.0.stream_episodes(v1::StreamEpisodesRequest {}).await).await?;
        let mut stream = stream.into_inner();
        while let Some(response) = stream.message().await? {
            let parts = proto::worker::episodes_from(response).map_err(|error| Status::internal(error.to_string()))?;
            parts.into_iter().for_each(|part| inputs.add(part));
        }
        Ok(())
    }

    /// The scores of the run that the job extends.
    pub(crate) async fn base_scores(&mut self) -> Result<Vec<EpisodeScores>> {
        let request = v1::StreamBaseScoresRequest {};
        let mut stream = self.0.stream_base_scores(request).await.map_err(refused)?.into_inner();
        let mut scores = Vec::new();
        while let Some(response) = stream.message().await.map_err(refused)? {
            scores.push(proto::worker::base_scores_from(response)?);
        }
        Ok(scores)
    }

    /// Reports progress; returns whether to stop.
    pub(crate) async fn report_progress(&mut self, progress: Progress) -> Result<bool> {
        let request = proto::worker::progress(progress);
        let response = with_retries(async || self.0.report_progress(request.clone()).await).await.map_err(refused)?;
        Ok(response.into_inner().cancel)
    }

    /// Names the blob to resume from. False when the blob is gone: another job had the same blob and removed it.
    pub(crate) async fn save_checkpoint(&mut self, step: u64, blob: BlobId) -> Result<bool> {
        let request = v1::SaveCheckpointRequest { step, blob: blob.into() };
        match with_retries(async || self.0.save_checkpoint(request.clone()).await).await {
            Ok(_) => Ok(true),
            Err(status) if status.code() == Code::NotFound => Ok(false),
            Err(status) => Err(refused(status)),
        }
    }

    /// Ends the job with its result. A result that the server rejects also ends the job.
    pub(crate) async fn complete(&mut self, made: Made) -> Result<()> {
        let messages = proto::worker::completion_messages(made);
        match with_retries(async || self.0.complete_job(stream::iter(messages.clone())).await).await {
            Ok(_) => Ok(()),
            Err(status) if status.code() == Code::Cancelled => Ok(()),
            Err(status) if matches!(status.code(), Code::InvalidArgument | Code::NotFound) => {
                // A missing blob can be made again; a result that does not fit would not fit the next time either.
                let again = status.code() == Code::NotFound;
                self.fail(format!("the server refused the result: {}", status.message()), again).await
            }
            Err(status) => Err(refused(status)),
        }
    }

    /// Ends the attempt with an error.
    pub(crate) async fn fail(&mut self, error: String, retry: bool) -> Result<()> {
        let request = v1::FailJobRequest { error, retry };
        with_retries(async || self.0.fail_job(request.clone()).await).await.map_err(refused)?;
        Ok(())
    }
}

/// Retries a call until the server accepts it, for up to [`PATIENCE`]: a full or slow disk must not end a job. Each
/// call also shows the server that the worker is alive.
async fn with_retries<T>(mut call: impl AsyncFnMut() -> tonic::Result<T>) -> tonic::Result<T> {
    let (begun, mut pause) = (Instant::now(), FIRST_PAUSE);
    loop {
        let status = match call().await {
            Err(status) if matches!(status.code(), Code::ResourceExhausted | Code::Unavailable) => status,
            answer => return answer,
        };
        if begun.elapsed() >= RETRY_FOR {
            return Err(status);
        }
        tracing::warn!(code = ?status.code(), reason = status.message(), "the server did not accept a message; retrying");
        sleep(pause).await;
        pause = LONGEST_PAUSE.min(pause * 2);
    }
}

fn refused(status: Status) -> Error {
    Error::unavailable(format!("the server answered {:?}: {}", status.code(), status.message()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test(start_paused = true)]
    async fn only_unavailable_and_exhausted_errors_are_retried() {
        for refused in [|| Status::resource_exhausted("no room"), || Status::unavailable("not now")] {
            let mut refusals = 5;
            let reply = with_retries(async || match refusals {
                0 => Ok("taken"),
                _ => {
                    refusals -= 1;
                    Err(refused())
                }
            });
            assert_eq!(reply.await.ok(), Some("taken"));
        }
        let (mut calls, begun) = (0, Instant::now());
        let answer: tonic::Result<()> = with_retries(async || {
            calls += 1;
            Err(Status::unavailable("never"))
        })
        .await;
        assert!(answer.is_err() && begun.elapsed() >= RETRY_FOR && calls > 100, "{calls} times");
        let mut calls = 0;
        let answer: tonic::Result<()> = with_retries(async || {
            calls += 1;
            Err(Status::invalid_argument("step: is wrong"))
        })
        .await;
        assert_eq!((answer.err().map(|status| status.code()), calls), (Some(Code::InvalidArgument), 1));
    }
}
