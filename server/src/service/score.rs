//! ScoreService: views of what score runs found.

use futures::stream::BoxStream;
use gleaner_proto::v1::{self, score_service_server::ScoreService};
use tonic::{Request, Response, Streaming};

use super::Services;
use crate::{
    access::Caller,
    error::Result,
    wire::{self, status::from_error},
};

/// Serves score runs.
pub(crate) struct Scores(pub(crate) Services);

impl Scores {
    async fn get_run(&self, id: &str) -> Result<v1::GetScoreRunResponse> {
        let run = self.0.store.score_run(&wire::score::score_run_id(id)?).await?;
        let counts = self.0.store.run_counts(&run).await?;
        Ok(v1::GetScoreRunResponse { score_run: Some(wire::score::score_run(run, counts)) })
    }

    async fn list_runs(&self, task: &str) -> Result<v1::ListScoreRunsResponse> {
        let task = self.0.store.task(task).await?;
        let mut score_runs = Vec::new();
        for run in self.0.store.score_runs(&task.id).await? {
            let counts = self.0.store.run_counts(&run).await?;
            score_runs.push(wire::score::score_run(run, counts));
        }
        Ok(v1::ListScoreRunsResponse { score_runs })
    }

    async fn scores(&self, request: v1::GetEpisodeScoresRequest) -> Result<v1::GetEpisodeScoresResponse> {
        let (run, episode) = wire::score::episode_scores_request(request)?;
        let run = self.0.store.score_run(&run).await?;
        let scores = self.0.store.episode_scores(&run.id, &episode).await?;
        Ok(v1::GetEpisodeScoresResponse { scores: Some(wire::score::episode_scores(scores, run.expert_ids)) })
    }

    async fn histogram(&self, request: v1::GetHistogramRequest) -> Result<v1::GetHistogramResponse> {
        let (run, empty) = wire::score::histogram_request(request)?;
        Ok(wire::score::histogram_response(&self.0.store.fill(&run, empty).await?))
    }

    async fn count(&self, request: v1::CountKeptRequest) -> Result<v1::CountKeptResponse> {
        let (run, selections, per_episode) = wire::score::count_request(request)?;
        let counts = self.0.store.count_kept(&run, selections).await?;
        let counts = counts.into_iter().map(|counted| wire::score::what_if(counted, per_episode)).collect();
        Ok(v1::CountKeptResponse { counts })
    }
}

#[tonic::async_trait]
impl ScoreService for Scores {
    async fn get_score_run(
        &self,
        request: Request<v1::GetScoreRunRequest>,
    ) -> tonic::Result<Response<v1::GetScoreRunResponse>> {
        let v1::GetScoreRunRequest { score_run_id } = request.into_inner();
        self.get_run(&score_run_id).await.map(Response::new).map_err(from_error)
    }

    async fn list_score_runs(
        &self,
        request: Request<v1::ListScoreRunsRequest>,
    ) -> tonic::Result<Response<v1::ListScoreRunsResponse>> {
        let v1::ListScoreRunsRequest { task } = request.into_inner();
        self.list_runs(&task).await.map(Response::new).map_err(from_error)
    }

    async fn get_episode_scores(
        &self,
        request: Request<v1::GetEpisodeScoresRequest>,
    ) -> tonic::Result<Response<v1::GetEpisodeScoresResponse>> {
        self.scores(request.into_inner()).await.map(Response::new).map_err(from_error)
    }

    async fn get_histogram(
        &self,
        request: Request<v1::GetHistogramRequest>,
    ) -> tonic::Result<Response<v1::GetHistogramResponse>> {
        self.histogram(request.into_inner()).await.map(Response::new).map_err(from_error)
    }

    type ScoreStepsStream = BoxStream<'static, tonic::Result<v1::ScoreStepsResponse>>;

    #[tracing::instrument(name = "score_recording", skip_all)]
    async fn score_recording(
        &self,
        request: Request<Streaming<v1::ScoreRecordingRequest>>,
    ) -> tonic::Result<Response<v1::ScoreRecordingResponse>> {
        let client = Caller::client_of(&request).map_err(from_error)?;
        self.0.score_recording(&client, request.into_inner()).await.map(Response::new).map_err(from_error)
    }

    async fn score_steps(
        &self,
        request: Request<Streaming<v1::ScoreStepsRequest>>,
    ) -> tonic::Result<Response<Self::ScoreStepsStream>> {
        Ok(Response::new(self.0.score_steps(request.into_inner())))
    }

    async fn count_kept(
        &self,
        request: Request<v1::CountKeptRequest>,
    ) -> tonic::Result<Response<v1::CountKeptResponse>> {
        self.count(request.into_inner()).await.map(Response::new).map_err(from_error)
    }
}
