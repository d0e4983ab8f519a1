//! The content of a score run as one digest, to compare runs bit for bit.

use gleaner_proto::v1::*;
use prost::Message as _;

use super::api::Api;

/// The digest of a run's normaliser, its experts' order, and every value of every episode's scores.
pub async fn digest(api: &mut Api, run: &str) -> blake3::Hash {
    let request = GetScoreRunRequest { score_run_id: run.to_owned() };
    let whole = api.scores.get_score_run(request).await.unwrap().into_inner().score_run.unwrap();
    let mut hasher = blake3::Hasher::new();
    for number in [whole.lo.to_bits(), whole.hi.to_bits(), whole.imperfect_segments, whole.expert_segments] {
        hasher.update(&number.to_le_bytes());
    }
    for episode in api.episode_ids().await {
        let request = GetEpisodeScoresRequest { score_run_id: run.to_owned(), episode_id: episode };
        // The run's snapshot may lack the episode.
        if let Ok(scores) = api.scores.get_episode_scores(request).await {
            hasher.update(&scores.into_inner().encode_to_vec());
        }
    }
    hasher.finalize()
}
