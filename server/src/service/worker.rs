//! WorkerService: orders and base scores for running workers, and their reports. The guard has identified the attempt that
//! each call comes from.

use futures::{StreamExt as _, TryStreamExt as _, stream};
use gleaner_proto::v1::{self, worker_service_server::WorkerService};
use tonic::{Request, Streaming};

use super::{
    Services,
    answer::{Reply, Responses, answer, responses},
};
use crate::{
    access::Worker,
    domain::job::JobSpec,
    error::Error,
    wire::{self, status::from_peer, worker::Completion},
};

/// Serves workers.
pub(crate) struct WorkerApi(pub(crate) Services);

#[tonic::async_trait]
impl WorkerService for WorkerApi {
    type StreamEpisodesStream = Responses<v1::StreamEpisodesResponse>;
    type StreamBaseScoresStream = Responses<v1::StreamBaseScoresResponse>;

    async fn get_assignment(&self, request: Request<v1::GetAssignmentRequest>) -> Reply<v1::GetAssignmentResponse> {
        answer(async {
            let Worker { job, .. } = Worker::any_rank(&request)?;
            let inputs = self.0.jobs.inputs(&job).await?;
            Ok(wire::worker::assignment(job, inputs))
        })
        .await
    }

    async fn stream_episodes(&self, request: Request<v1::StreamEpisodesRequest>) -> Reply<Self::StreamEpisodesStream> {
        answer(async {
            let Worker { job, .. } = Worker::any_rank(&request)?;
            let parts = self.0.jobs.input_parts(&job).await?;
            Ok(responses(parts.map_ok(wire::worker::episodes)))
        })
        .await
    }

    /// One episode's scores at a time, read as the worker takes them.
    async fn stream_base_scores(
        &self,
        request: Request<v1::StreamBaseScoresRequest>,
    ) -> Reply<Self::StreamBaseScoresStream> {
        answer(async {
            let Worker { job, .. } = Worker::any_rank(&request)?;
            let JobSpec::Score { extends: Some(run), .. } = job.spec else {
                return Err(Error::precondition(format!("{} extends no earlier run", job.id)));
            };
            let store = self.0.store.clone();
            let scores = stream::iter(store.scored_episodes(&run).await?).then(move |episode| {
                let (store, run) = (store.clone(), run.clone());
                async move { store.episode_scores(&run, &episode).await }
            });
            Ok(responses(scores.map_ok(wire::worker::base_scores)))
        })
        .await
    }

    async fn report_meeting(&self, request: Request<v1::ReportMeetingRequest>) -> Reply<v1::ReportMeetingResponse> {
        answer(async {
            let Worker { attempt, .. } = Worker::of(&request)?;
            self.0.jobs.report_meeting(&attempt, wire::worker::meeting_request(request.into_inner())?);
            Ok(v1::ReportMeetingResponse {})
        })
        .await
    }

    async fn get_meeting(&self, request: Request<v1::GetMeetingRequest>) -> Reply<v1::GetMeetingResponse> {
        answer(async {
            let Worker { attempt, .. } = Worker::any_rank(&request)?;
            let address = self.0.jobs.meeting(&attempt).await;
            Ok(v1::GetMeetingResponse { address: address.map(|address| address.to_string()).unwrap_or_default() })
        })
        .await
    }

    async fn report_progress(&self, request: Request<v1::ReportProgressRequest>) -> Reply<v1::ReportProgressResponse> {
        answer(async {
            let Worker { attempt, .. } = Worker::of(&request)?;
            let progress = wire::worker::progress_request(request.into_inner())?;
            Ok(v1::ReportProgressResponse { cancel: self.0.jobs.progress(&attempt, &progress).await? })
        })
        .await
    }

    async fn save_checkpoint(&self, request: Request<v1::SaveCheckpointRequest>) -> Reply<v1::SaveCheckpointResponse> {
        answer(async {
            let Worker { attempt, .. } = Worker::of(&request)?;
            let (step, blob) = wire::worker::checkpoint_request(request.into_inner())?;
            self.0.jobs.checkpoint(&attempt, step, &blob).await?;
            Ok(v1::SaveCheckpointResponse {})
        })
        .await
    }

    async fn complete_job(
        &self,
        request: Request<Streaming<v1::CompleteJobRequest>>,
    ) -> Reply<v1::CompleteJobResponse> {
        let worker = Worker::of(&request);
        answer(async {
            let Worker { attempt, job, .. } = worker?;
            let (mut messages, mut completion) = (request.into_inner(), Completion::default());
            while let Some(message) = messages.message().await.map_err(from_peer)? {
                completion.push(message)?;
            }
            self.0.jobs.complete(&attempt, &job, completion.whole()?).await?;
            Ok(v1::CompleteJobResponse {})
        })
        .await
    }

    async fn fail_job(&self, request: Request<v1::FailJobRequest>) -> Reply<v1::FailJobResponse> {
        answer(async {
            let Worker { attempt, .. } = Worker::of(&request)?;
            let (error, retry) = wire::worker::fail_request(request.into_inner());
            self.0.jobs.fail(&attempt, error, retry).await?;
            Ok(v1::FailJobResponse {})
        })
        .await
    }
}
