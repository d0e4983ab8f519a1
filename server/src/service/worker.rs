//! WorkerService: what running workers ask and say. The guard knows which attempt each call comes from.

use futures::{StreamExt as _, TryStreamExt as _, stream, stream::BoxStream};
use gleaner_proto::v1::{self, worker_service_server::WorkerService};
use prost::Message as _;
use tonic::{Request, Response, Streaming};

use super::Services;
use crate::{
    access::Worker,
    domain::{
        attempt::Attempt,
        job::{Job, JobSpec},
    },
    error::{Error, Result},
    wire::{
        self,
        status::{from_error, from_peer},
        worker::Completion,
    },
};

/// Serves workers.
pub(crate) struct Workers(pub(crate) Services);

impl Workers {
    async fn assignment(&self, job: Job) -> Result<v1::GetAssignmentResponse> {
        let inputs = self.0.jobs.inputs(&job).await?;
        let assignment = wire::worker::assignment(job, inputs);
        let (size, most) = (assignment.encoded_len(), self.0.config.limits.max_message_bytes);
        if size > most {
            return Err(Error::precondition(format!(
                "what this job works on takes {size} bytes to tell, more than a message may have ({most}): keep fewer steps, or \
                 raise --max-message-bytes at the server"
            )));
        }
        Ok(assignment)
    }

    /// One episode's scores at a time, read as the worker takes them.
    async fn base_scores(&self, job: Job) -> Result<BoxStream<'static, tonic::Result<v1::StreamBaseScoresResponse>>> {
        let JobSpec::Score { extends: Some(run), .. } = job.spec else {
            return Err(Error::precondition(format!("{} goes on from no earlier run", job.id)));
        };
        let store = self.0.store.clone();
        let scores = stream::iter(store.scored_episodes(&run).await?).then(move |episode| {
            let (store, run) = (store.clone(), run.clone());
            async move { store.episode_scores(&run, &episode).await }
        });
        Ok(scores.map_ok(wire::worker::base_scores).map_err(from_error).boxed())
    }

    async fn progress(
        &self,
        attempt: &Attempt,
        request: v1::ReportProgressRequest,
    ) -> Result<v1::ReportProgressResponse> {
        let cancel = self.0.jobs.progress(attempt, &wire::worker::progress_request(request)?).await?;
        Ok(v1::ReportProgressResponse { cancel })
    }

    async fn checkpoint(
        &self,
        attempt: &Attempt,
        request: v1::SaveCheckpointRequest,
    ) -> Result<v1::SaveCheckpointResponse> {
        let (step, blob) = wire::worker::checkpoint_request(request)?;
        self.0.jobs.checkpoint(attempt, step, &blob).await?;
        Ok(v1::SaveCheckpointResponse {})
    }

    async fn complete(
        &self,
        attempt: &Attempt,
        job: &Job,
        mut messages: Streaming<v1::CompleteJobRequest>,
    ) -> Result<v1::CompleteJobResponse> {
        let mut completion = Completion::default();
        while let Some(message) = messages.message().await.map_err(from_peer)? {
            completion.push(message)?;
        }
        self.0.jobs.complete(attempt, job, completion.whole()?).await?;
        Ok(v1::CompleteJobResponse {})
    }

    async fn fail(&self, attempt: &Attempt, request: v1::FailJobRequest) -> Result<v1::FailJobResponse> {
        let (error, retry) = wire::worker::fail_request(request);
        self.0.jobs.fail(attempt, error, retry).await?;
        Ok(v1::FailJobResponse {})
    }
}

#[tonic::async_trait]
impl WorkerService for Workers {
    type StreamBaseScoresStream = BoxStream<'static, tonic::Result<v1::StreamBaseScoresResponse>>;

    async fn get_assignment(
        &self,
        request: Request<v1::GetAssignmentRequest>,
    ) -> tonic::Result<Response<v1::GetAssignmentResponse>> {
        let Worker { job, .. } = Worker::of(&request).map_err(from_error)?;
        self.assignment(job).await.map(Response::new).map_err(from_error)
    }

    async fn stream_base_scores(
        &self,
        request: Request<v1::StreamBaseScoresRequest>,
    ) -> tonic::Result<Response<Self::StreamBaseScoresStream>> {
        let Worker { job, .. } = Worker::of(&request).map_err(from_error)?;
        self.base_scores(job).await.map(Response::new).map_err(from_error)
    }

    async fn report_progress(
        &self,
        request: Request<v1::ReportProgressRequest>,
    ) -> tonic::Result<Response<v1::ReportProgressResponse>> {
        let Worker { attempt, .. } = Worker::of(&request).map_err(from_error)?;
        self.progress(&attempt, request.into_inner()).await.map(Response::new).map_err(from_error)
    }

    async fn save_checkpoint(
        &self,
        request: Request<v1::SaveCheckpointRequest>,
    ) -> tonic::Result<Response<v1::SaveCheckpointResponse>> {
        let Worker { attempt, .. } = Worker::of(&request).map_err(from_error)?;
        self.checkpoint(&attempt, request.into_inner()).await.map(Response::new).map_err(from_error)
    }

    async fn complete_job(
        &self,
        request: Request<Streaming<v1::CompleteJobRequest>>,
    ) -> tonic::Result<Response<v1::CompleteJobResponse>> {
        let Worker { attempt, job } = Worker::of(&request).map_err(from_error)?;
        self.complete(&attempt, &job, request.into_inner()).await.map(Response::new).map_err(from_error)
    }

    async fn fail_job(&self, request: Request<v1::FailJobRequest>) -> tonic::Result<Response<v1::FailJobResponse>> {
        let Worker { attempt, .. } = Worker::of(&request).map_err(from_error)?;
        self.fail(&attempt, request.into_inner()).await.map(Response::new).map_err(from_error)
    }
}
