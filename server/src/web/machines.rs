//! What programs ask for: `/metrics` for Prometheus and `/healthz` for whoever keeps the server running.

use axum::{
    http::StatusCode,
    response::{IntoResponse as _, Response},
};

use super::{refusal::Answer, visit::Visit, vitals};

pub(super) async fn metrics(visit: Visit) -> Answer {
    vitals::take(visit.rooms()).await?;
    Ok(visit.house.metrics.render().into_response())
}

pub(super) async fn health(visit: Visit) -> Response {
    if visit.rooms().stopping.is_cancelled() {
        (StatusCode::SERVICE_UNAVAILABLE, "stopping\n").into_response()
    } else if let Err(error) = visit.rooms().store.verify() {
        (StatusCode::SERVICE_UNAVAILABLE, format!("{}\n", error.message())).into_response()
    } else {
        (StatusCode::OK, "serving\n").into_response()
    }
}
