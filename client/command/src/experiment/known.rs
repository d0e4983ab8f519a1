//! Results without a job that an earlier run made, if the server still has them.

use gleaner_client::Client;
use gleaner_proto::v1::{GetEvaluationRequest, GetScoreRunRequest, GetSnapshotRequest};
use tonic::{Code, Status};

use super::standing::StageResult;
use super::state::State;
use crate::failure::Result;

/// The snapshot that an earlier run made, if this server has it.
pub(super) async fn known_snapshot(client: &Client, state: &State, key: &str) -> Result<Option<StageResult>> {
    let Some(id) = state.snapshot(key) else { return Ok(None) };
    let request = GetSnapshotRequest { snapshot_id: id.to_owned(), omit_episodes: true };
    known(id, client.snapshots().get_snapshot(request).await.map(drop))
}

/// The imported score run that an earlier run made, if this server has it.
pub(super) async fn known_run(client: &Client, state: &State, key: &str) -> Result<Option<StageResult>> {
    let Some(id) = state.run(key) else { return Ok(None) };
    let request = GetScoreRunRequest { score_run_id: id.to_owned() };
    known(id, client.scores().get_score_run(request).await.map(drop))
}

/// The evaluation that an earlier run reported, if this server has it.
pub(super) async fn known_evaluation(client: &Client, state: &State, key: &str) -> Result<Option<StageResult>> {
    let Some(id) = state.evaluation(key) else { return Ok(None) };
    let request = GetEvaluationRequest { evaluation_id: id.to_owned() };
    known(id, client.policies().get_evaluation(request).await.map(drop))
}

fn known(id: &str, reply: std::result::Result<(), Status>) -> Result<Option<StageResult>> {
    match reply {
        Ok(()) => Ok(Some(StageResult { id: id.to_owned(), job: None })),
        // Another server, or its data are gone.
        Err(status) if status.code() == Code::NotFound => Ok(None),
        Err(status) => Err(status.into()),
    }
}
