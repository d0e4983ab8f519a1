//! Endpoints for programs: `/metrics` for Prometheus and `/healthz` for a supervisor.

use axum::{
    http::StatusCode,
    response::{IntoResponse as _, Response},
};

use super::{page_request::PageRequest, refusal::Answer, vitals};

pub(super) async fn metrics(request: PageRequest) -> Answer {
    vitals::take(request.services()).await?;
    Ok(request.state.metrics.render().into_response())
}

pub(super) async fn health(request: PageRequest) -> Response {
    if request.services().stopping.is_cancelled() {
        (StatusCode::SERVICE_UNAVAILABLE, "stopping\n").into_response()
    } else if let Err(error) = request.services().store.verify() {
        (StatusCode::SERVICE_UNAVAILABLE, format!("{}\n", error.message())).into_response()
    } else {
        (StatusCode::OK, "serving\n").into_response()
    }
}
