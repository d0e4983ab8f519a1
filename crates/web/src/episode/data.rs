//! Data of an episode for the page's script and other programs: its scores in one run, and its recording.

use axum::{
    body::Body,
    extract::Path,
    http::header::{CONTENT_DISPOSITION, CONTENT_LENGTH, CONTENT_TYPE},
    response::IntoResponse as _,
};
use gleaner_core::{
    Error,
    id::{EpisodeId, ScoreRunId},
};
use serde::Deserialize;
use serde_json::json;

use super::scored;
use crate::{page_request::PageRequest, refusal::Answer};

#[derive(Default, Deserialize)]
#[serde(default)]
struct Parameters {
    run: String,
}

/// q and w of every segment, its match and the distances to it. `match_episode` is an index into `experts`; the last
/// three lists are empty when the run's scorer has no matches.
pub(crate) async fn scores(request: PageRequest, Path(id): Path<String>) -> Answer {
    let Parameters { run } = request.parameters()?;
    let id = EpisodeId::parse("episode", &id)?;
    let backend = request.backend();
    let run = if run.is_empty() {
        let episode = backend.episode(&id).await?.episode;
        let newest = backend.runs_that_scored(&episode.task_id, &id).await?.into_iter().next();
        newest.ok_or_else(|| Error::not_found("score run of", &id))?
    } else {
        ScoreRunId::parse("run", &run)?
    };
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
    let headers = [
        (CONTENT_TYPE, "application/octet-stream".to_owned()),
        (CONTENT_DISPOSITION, format!("attachment; filename=\"{id}.mcap\"")),
        (CONTENT_LENGTH, episode.size_bytes.to_string()),
    ];
    Ok((headers, Body::from_stream(bytes)).into_response())
}
