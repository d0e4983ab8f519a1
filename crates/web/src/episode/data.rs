//! Data of an episode for the page's script and other programs: its scores in one run, and its recording without and with
//! them.

use axum::{
    body::Body,
    extract::Path,
    http::header::{CONTENT_DISPOSITION, CONTENT_LENGTH, CONTENT_TYPE},
    response::{IntoResponse as _, Response},
};
use bytes::Bytes;
use futures::stream::BoxStream;
use gleaner_core::{
    Error, Result,
    id::{EpisodeId, ScoreRunId},
};
use serde::Deserialize;
use serde_json::json;

use super::{scored, threshold};
use crate::{Backend, page_request::PageRequest, refusal::Answer};

#[derive(Default, Deserialize)]
#[serde(default)]
struct Parameters {
    run: String,
    beta: String,
}

/// q and w of every segment, its match and the distances to it. `match_episode` is an index into `experts`; the last
/// three lists are empty when the run's scorer has no matches.
pub(crate) async fn scores(request: PageRequest, Path(id): Path<String>) -> Answer {
    let Parameters { run, .. } = request.parameters()?;
    let id = EpisodeId::parse("episode", &id)?;
    let backend = request.backend();
    let run = run_of(backend, &id, &run).await?;
    let scored = scored(backend, &id, backend.score_run(&run).await?).await?;
    let scores = &scored.scores;
    let answer = json!({
        "episode": id, "run": run, "role": scores.role.as_str(), "segment_length": scored.segment_length,
        "q": scores.q, "w": scores.w, "experts": scored.run.expert_ids, "match_episode": scores.match_episode,
        "match_step": scores.match_step, "distances": scores.distances,
    });
    Ok(axum::Json(answer).into_response())
}

/// The recording as uploaded.
pub(crate) async fn recording(request: PageRequest, Path(id): Path<String>) -> Answer {
    let id = EpisodeId::parse("episode", &id)?;
    let episode = request.backend().episode(&id).await?.episode;
    let bytes = request.backend().recording(&episode).await?;
    Ok(attachment(&format!("{id}.mcap"), episode.size_bytes, bytes))
}

/// The recording with the scores of a run, the newest that scored the episode if none is named.
pub(crate) async fn scored_recording(request: PageRequest, Path(id): Path<String>) -> Answer {
    let Parameters { run, beta } = request.parameters()?;
    let id = EpisodeId::parse("episode", &id)?;
    let threshold = threshold(&beta)?;
    let backend = request.backend();
    let run = run_of(backend, &id, &run).await?;
    let beta = match threshold {
        Some(beta) => beta,
        None => backend.score_run(&run).await?.origin.default_beta(),
    };
    let episode = backend.episode(&id).await?.episode;
    let (size, bytes) = backend.scored_recording(&request.caller, &episode, &run, beta).await?;
    Ok(attachment(&format!("{id}_{run}.mcap"), size, bytes))
}

/// The run that is named, or the newest that scored the episode.
async fn run_of(backend: &dyn Backend, id: &EpisodeId, named: &str) -> Result<ScoreRunId> {
    if !named.is_empty() {
        return ScoreRunId::parse("run", named);
    }
    let episode = backend.episode(id).await?.episode;
    let newest = backend.runs_that_scored(&episode.task_id, id).await?.into_iter().next();
    newest.ok_or_else(|| Error::not_found("score run of", id))
}

fn attachment(name: &str, size: u64, bytes: BoxStream<'static, Result<Bytes>>) -> Response {
    let headers = [
        (CONTENT_TYPE, "application/octet-stream".to_owned()),
        (CONTENT_DISPOSITION, format!("attachment; filename=\"{name}\"")),
        (CONTENT_LENGTH, size.to_string()),
    ];
    (headers, Body::from_stream(bytes)).into_response()
}
