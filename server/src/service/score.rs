//! ScoreService: views of finished score runs, imports, and scores of recordings and steps that are not stored.

use gleaner_proto::v1::{self, score_service_server::ScoreService};
use tonic::{Request, Response, Streaming};

use super::{
    Services,
    answer::{Reply, Responses, answer, change_by},
};
use crate::{access::Caller, wire};

/// Serves score runs.
pub(crate) struct ScoreApi(pub(crate) Services);

#[tonic::async_trait]
impl ScoreService for ScoreApi {
    async fn get_score_run(&self, request: Request<v1::GetScoreRunRequest>) -> Reply<v1::GetScoreRunResponse> {
        answer(async {
            let run = self.0.store.score_run(&wire::score::score_run_id(&request.get_ref().score_run_id)?).await?;
            let counts = self.0.store.run_counts(&run).await?;
            Ok(v1::GetScoreRunResponse { score_run: Some(wire::score::score_run(run, counts)) })
        })
        .await
    }

    async fn list_score_runs(&self, request: Request<v1::ListScoreRunsRequest>) -> Reply<v1::ListScoreRunsResponse> {
        answer(async {
            let (task, page) = wire::score::list_request(request.into_inner())?;
            let task = self.0.store.task(&task).await?;
            let (runs, next) = self.0.store.score_runs_page(&task.id, &page).await?;
            let mut score_runs = Vec::with_capacity(runs.len());
            for run in runs {
                let counts = self.0.store.run_counts(&run).await?;
                score_runs.push(wire::score::score_run(run, counts));
            }
            Ok(v1::ListScoreRunsResponse { score_runs, next_page_token: wire::page::token(next) })
        })
        .await
    }

    async fn get_episode_scores(
        &self,
        request: Request<v1::GetEpisodeScoresRequest>,
    ) -> Reply<v1::GetEpisodeScoresResponse> {
        answer(async {
            let (run, episode) = wire::score::episode_scores_request(request.into_inner())?;
            let run = self.0.store.score_run(&run).await?;
            let scores = self.0.store.episode_scores(&run.id, &episode).await?;
            Ok(v1::GetEpisodeScoresResponse { scores: Some(wire::score::episode_scores(scores, run.expert_ids)) })
        })
        .await
    }

    async fn get_histogram(&self, request: Request<v1::GetHistogramRequest>) -> Reply<v1::GetHistogramResponse> {
        answer(async {
            let (run, empty) = wire::score::histogram_request(request.into_inner())?;
            let summary = self.0.curation.summary(&run).await?;
            let histogram = summary.fill(empty).await?;
            Ok(wire::score::histogram_response(&histogram, summary.expert_ranking().await?))
        })
        .await
    }

    async fn count_kept(&self, request: Request<v1::CountKeptRequest>) -> Reply<v1::CountKeptResponse> {
        answer(async {
            let (run, selections, per_episode) = wire::selection::count_request(request.into_inner())?;
            let counts = self.0.curation.count_kept(&run, selections).await?;
            let counts = counts.into_iter().map(|counted| wire::selection::what_if(counted, per_episode)).collect();
            Ok(v1::CountKeptResponse { counts })
        })
        .await
    }

    #[tracing::instrument(name = "score_recording", skip_all)]
    async fn score_recording(
        &self,
        request: Request<Streaming<v1::ScoreRecordingRequest>>,
    ) -> Reply<v1::ScoreRecordingResponse> {
        let client = Caller::client_of(&request);
        answer(async { self.0.score_recording(&client?, request.into_inner()).await }).await
    }

    type ScoreStepsStream = Responses<v1::ScoreStepsResponse>;

    async fn score_steps(&self, request: Request<Streaming<v1::ScoreStepsRequest>>) -> Reply<Self::ScoreStepsStream> {
        Ok(Response::new(self.0.score_steps(request.into_inner())))
    }

    #[tracing::instrument(name = "import_scores", skip_all)]
    async fn import_scores(
        &self,
        request: Request<Streaming<v1::ImportScoresRequest>>,
    ) -> Reply<v1::ImportScoresResponse> {
        change_by(request, async |audit, requests| self.0.import_scores(audit, requests).await).await
    }
}
