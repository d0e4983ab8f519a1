//! The worker's calls to its server, each with the attempt's token.

use std::time::Duration;

use futures::stream;
use gleaner_proto::v1::{self, worker_service_client::WorkerServiceClient};
use tonic::{
    Code, Request, Status,
    metadata::{Ascii, MetadataValue},
    service::{Interceptor, interceptor::InterceptedService},
    transport::{Channel, Endpoint},
};

use crate::{
    config::WorkerConfig,
    domain::{
        id::{BlobId, JobId},
        order::JobOrder,
        score::EpisodeScores,
        work::{Inputs, Made, Progress},
    },
    error::{Error, Result},
    wire,
};

const CONNECT_TIMEOUT: Duration = Duration::from_secs(10);

/// Adds the token to every call.
#[derive(Clone)]
struct Bearer(MetadataValue<Ascii>);

impl Interceptor for Bearer {
    fn call(&mut self, mut request: Request<()>) -> std::result::Result<Request<()>, Status> {
        request.metadata_mut().insert("authorization", self.0.clone());
        Ok(request)
    }
}

/// The server, as one attempt of one job sees it.
pub(super) struct Client(WorkerServiceClient<InterceptedService<Channel, Bearer>>);

impl Client {
    /// Connects.
    ///
    /// # Errors
    /// Unavailable when the server does not answer.
    pub(super) async fn connect(config: &WorkerConfig) -> Result<Self> {
        let channel = Endpoint::from_shared(config.server.clone())
            .map_err(|error| Error::invalid("--server", error))?
            .connect_timeout(CONNECT_TIMEOUT)
            .tcp_nodelay(true)
            .connect()
            .await
            .map_err(|error| Error::unavailable(format!("the server {} does not answer: {error}", config.server)))?;
        let mut bearer: MetadataValue<Ascii> = format!("Bearer {}", config.token.reveal())
            .parse()
            .map_err(|_| Error::invalid("GLEANER_JOB_TOKEN", "is no token"))?;
        bearer.set_sensitive(true);
        let client = WorkerServiceClient::with_interceptor(channel, Bearer(bearer))
            .max_decoding_message_size(config.max_message_bytes)
            .max_encoding_message_size(config.max_message_bytes);
        Ok(Self(client))
    }

    /// Which job, what to do, and with what.
    pub(super) async fn assignment(&mut self) -> Result<(JobId, JobOrder, Inputs)> {
        let response = self.0.get_assignment(v1::GetAssignmentRequest {}).await.map_err(refused)?;
        wire::worker::assigned(response.into_inner())
    }

    /// The scores of the run that the job goes on from.
    pub(super) async fn base_scores(&mut self) -> Result<Vec<EpisodeScores>> {
        let request = v1::StreamBaseScoresRequest {};
        let mut stream = self.0.stream_base_scores(request).await.map_err(refused)?.into_inner();
        let mut scores = Vec::new();
        while let Some(response) = stream.message().await.map_err(refused)? {
            scores.push(wire::worker::base_scores_from(response)?);
        }
        Ok(scores)
    }

    /// Tells how far it is; the answer says whether to stop.
    pub(super) async fn report_progress(&mut self, progress: Progress) -> Result<bool> {
        let response = self.0.report_progress(wire::worker::progress(progress)).await.map_err(refused)?;
        Ok(response.into_inner().cancel)
    }

    /// Names the blob to resume from.
    pub(super) async fn save_checkpoint(&mut self, step: u64, blob: BlobId) -> Result<()> {
        let request = v1::SaveCheckpointRequest { step, blob: blob.into() };
        self.0.save_checkpoint(request).await.map_err(refused)?;
        Ok(())
    }

    /// Ends the job with what it made. A result that the server does not take ends it too.
    pub(super) async fn complete(&mut self, made: Made) -> Result<()> {
        let messages = stream::iter(wire::worker::completion_messages(made));
        match self.0.complete_job(messages).await {
            Ok(_) => Ok(()),
            Err(status) if status.code() == Code::Cancelled => Ok(()),
            Err(status) if matches!(status.code(), Code::InvalidArgument | Code::NotFound) => {
                self.fail(format!("the server refused the result: {}", status.message()), false).await
            }
            Err(status) => Err(refused(status)),
        }
    }

    /// Ends the attempt with an error.
    pub(super) async fn fail(&mut self, error: String, retry: bool) -> Result<()> {
        self.0.fail_job(v1::FailJobRequest { error, retry }).await.map_err(refused)?;
        Ok(())
    }
}

fn refused(status: Status) -> Error {
    Error::unavailable(format!("the server answered {:?}: {}", status.code(), status.message()))
}
