//! Actions on a job from its page.

use axum::{extract::Path, http::HeaderMap, response::Response};
use gleaner_core::{id::JobId, job::Job};
use serde_json::json;

use crate::{
    change::{change, done, is_json},
    page_request::PageRequest,
    refusal::Answer,
};

/// Cancels a job and the jobs that wait for it.
pub(crate) async fn cancel(request: PageRequest, Path(id): Path<String>, headers: HeaderMap) -> Response {
    let cancelled = async { answer(&headers, &request.backend().cancel_job(&JobId::parse("id", &id)?).await?) };
    change(&request, [("job_id", id.as_str())], cancelled).await
}

/// Submits the same order again, and the jobs that waited for it.
pub(crate) async fn retry(request: PageRequest, Path(id): Path<String>, headers: HeaderMap) -> Response {
    let again = async { answer(&headers, &request.backend().retry_job(&JobId::parse("id", &id)?).await?) };
    change(&request, [("job_id", id.as_str())], again).await
}

fn answer(headers: &HeaderMap, job: &Job) -> Answer {
    let page = format!("/jobs/{}", job.id);
    Ok(done(is_json(headers), &page, json!({ "job_id": job.id, "state": job.state.as_str(), "page": page })))
}
