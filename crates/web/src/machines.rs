//! Endpoints for programs: `/metrics` for Prometheus and `/healthz` for a supervisor.

use axum::{
    http::StatusCode,
    response::{IntoResponse as _, Response},
};

use super::{page_request::PageRequest, refusal::Answer};

pub(super) async fn metrics(request: PageRequest) -> Answer {
    Ok(request.backend().metrics().await?.into_response())
}

pub(super) async fn health(request: PageRequest) -> Response {
    match request.backend().health() {
        Ok(()) => (StatusCode::OK, "serving\n").into_response(),
        Err(error) => (StatusCode::SERVICE_UNAVAILABLE, format!("{}\n", error.message())).into_response(),
    }
}
