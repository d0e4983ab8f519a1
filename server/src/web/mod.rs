//! Pages on an address of their own: `/metrics` for Prometheus and `/healthz` for whoever keeps the server running.
//!
//! Knows HTTP. Must not know gRPC.

mod gate;
mod vitals;

use std::time::Duration;

use axum::{Router, extract::State, http::StatusCode, routing::get};
use http::{HeaderValue, header::CONNECTION};
use metrics_exporter_prometheus::PrometheusHandle;
use tokio::net::TcpListener;
use tokio_util::task::AbortOnDropHandle;

use self::gate::Gate;
use crate::{
    config::ConnectionsConfig,
    error::{Error, Result},
    service::Rooms,
    telemetry,
};

/// Connections at once: whoever watches needs few.
const CONNECTIONS: usize = 64;
/// How often what was measured is summed up, so that it does not pile up when nobody looks.
const UPKEEP: Duration = Duration::from_secs(5);

/// What the pages show.
#[derive(Clone)]
struct Shown {
    rooms: Rooms,
    metrics: PrometheusHandle,
}

/// Opens the pages, until what this gives is dropped.
///
/// # Errors
/// Internal when metrics cannot be set up.
pub(crate) fn open(rooms: Rooms, listener: TcpListener) -> Result<AbortOnDropHandle<()>> {
    let metrics = telemetry::metrics::recorder()?;
    Ok(AbortOnDropHandle::new(tokio::spawn(async move {
        if let Err(error) = serve(rooms, listener, metrics).await {
            tracing::error!(%error, "the pages are gone");
        }
    })))
}

async fn serve(rooms: Rooms, listener: TcpListener, metrics: PrometheusHandle) -> Result<()> {
    let config = ConnectionsConfig {
        max_connections: CONNECTIONS,
        max_connections_per_address: CONNECTIONS,
        ..rooms.config.connections.clone()
    };
    let gate = Gate::new(config, listener)?;
    let pages = Router::new()
        .route("/metrics", get(show_metrics))
        .route("/healthz", get(health))
        // One request a connection: what is silent afterwards is nobody's.
        .layer(axum::middleware::map_response(|mut response: axum::response::Response| async {
            response.headers_mut().insert(CONNECTION, HeaderValue::from_static("close"));
            response
        }))
        .with_state(Shown { rooms, metrics: metrics.clone() });
    let upkeep = async {
        loop {
            tokio::time::sleep(UPKEEP).await;
            metrics.run_upkeep();
        }
    };
    tokio::select! {
        served = axum::serve(gate, pages) => served.map_err(|error| Error::internal("serving pages", error)),
        () = upkeep => Ok(()),
    }
}

async fn show_metrics(State(shown): State<Shown>) -> (StatusCode, String) {
    match vitals::take(&shown.rooms).await {
        Ok(()) => (StatusCode::OK, shown.metrics.render()),
        Err(error) => {
            tracing::error!(%error, "the metrics cannot be told");
            (StatusCode::INTERNAL_SERVER_ERROR, "the server's log tells what is wrong\n".to_owned())
        }
    }
}

async fn health(State(shown): State<Shown>) -> (StatusCode, &'static str) {
    if shown.rooms.stopping.is_cancelled() {
        (StatusCode::SERVICE_UNAVAILABLE, "stopping\n")
    } else {
        (StatusCode::OK, "serving\n")
    }
}
