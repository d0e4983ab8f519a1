//! Actions on a job from its page.

use axum::{extract::Path, http::HeaderMap, response::Response};
use gleaner_core::{Result, id::JobId, job::Job};
use serde_json::json;

use crate::{
    change::{about, done, is_json},
    page_request::PageRequest,
};

/// Cancels a job and the jobs that wait for it.
pub(crate) async fn cancel(request: PageRequest, Path(id): Path<String>, headers: HeaderMap) -> Response {
    let cancelled = async { request.backend().cancel_job(&JobId::parse("id", &id)?).await };
    answer(&id, &headers, cancelled.await)
}

/// Submits the same order again, and the jobs that waited for it.
pub(crate) async fn retry(request: PageRequest, Path(id): Path<String>, headers: HeaderMap) -> Response {
    let again = async { request.backend().retry_job(&JobId::parse("id", &id)?).await };
    answer(&id, &headers, again.await)
}

fn answer(id: &str, headers: &HeaderMap, moved: Result<Job>) -> Response {
    let answer = |job: Job| {
        let page = format!("/jobs/{}", job.id);
        done(is_json(headers), &page, json!({ "job_id": job.id, "state": job.state.as_str(), "page": page }))
    };
    about([("job_id", id)], moved.map(answer).map_err(Into::into))
}
