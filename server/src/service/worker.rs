//! WorkerService: orders and base scores for running workers, and their reports. The guard has identified the attempt that
//! each call comes from.

use futures::{TryStreamExt as _, stream};
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
    jobs::Located,
    wire::{
        self,
        status::from_peer,
        worker::{BlobQuery, Completion},
    },
};

/// Episodes whose scores are read by one query: few, because an episode may be long and the worker may read slowly.
const EPISODES: u32 = 16;

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

    /// One episode's scores in each message. A few of them are read at a time, as the worker takes them, so that no query
    /// stays open for a slow worker.
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
            let parts = stream::try_unfold(-1, move |behind| {
                let (store, run) = (store.clone(), run.clone());
                async move {
                    let read = store.scores_behind(&run, behind, EPISODES).await;
                    read.map(|(scores, last)| last.map(|last| (stream::iter(scores.into_iter().map(Ok)), last)))
                }
            });
            Ok(responses(parts.try_flatten().map_ok(wire::worker::base_scores)))
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

    async fn locate_blob(&self, request: Request<v1::LocateBlobRequest>) -> Reply<v1::LocateBlobResponse> {
        answer(async {
            Worker::any_rank(&request)?;
            let BlobQuery { blob, accept_url, fetch } = wire::worker::locate_request(request.into_inner())?;
            let Located { size_bytes, url } = self.0.jobs.locate_blob(&blob, accept_url, fetch).await?;
            let url = url.map(|url| url.reveal().to_owned()).unwrap_or_default();
            Ok(v1::LocateBlobResponse { size_bytes, url })
        })
        .await
    }

    async fn store_blob(&self, request: Request<v1::StoreBlobRequest>) -> Reply<v1::StoreBlobResponse> {
        answer(async {
            let Worker { attempt, .. } = Worker::of(&request)?;
            let blob = wire::worker::store_request(request.into_inner())?;
            self.0.jobs.store_blob(&attempt, &blob).await?;
            Ok(v1::StoreBlobResponse {})
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
                // A large result takes long, and the worker makes no other call meanwhile.
                self.0.jobs.renew(&attempt);
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
