//! Single results of the server: the scores of an episode, the success of a policy.

use gleaner_client::Client;
use gleaner_proto::v1::{EpisodeScores, GetEpisodeScoresRequest, GetEvaluationRequest};

use super::rate::Rate;
use crate::failure::{Result, present};

/// Requests under way at the same time.
pub(super) const PARALLEL: usize = 8;

/// The scores of one episode under a run.
pub(super) async fn scores(client: &Client, run_id: &str, episode_id: &str) -> Result<EpisodeScores> {
    let (score_run_id, episode_id) = (run_id.to_owned(), episode_id.to_owned());
    let request = GetEpisodeScoresRequest { score_run_id, episode_id };
    present(client.scores().get_episode_scores(request).await?.into_inner().scores, "scores")
}

/// The success rate that an evaluation found.
pub(super) async fn success(client: &Client, evaluation_id: &str) -> Result<Rate> {
    let request = GetEvaluationRequest { evaluation_id: evaluation_id.to_owned() };
    let reply = client.policies().get_evaluation(request).await?.into_inner();
    let evaluation = present(reply.evaluation, "an evaluation")?;
    Ok(Rate::new(evaluation.successes, evaluation.episodes))
}
