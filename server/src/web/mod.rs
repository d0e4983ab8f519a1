//! The curation pages for people, and the endpoints for monitoring, on an address of their own.
//!
//! Uses the same services as the gRPC interface, behind the same table of roles. Knows HTTP and HTML; must not know
//! gRPC, SQL or tensors. Every page has a row in the authorisation table, and every handler the middleware.

mod artifacts;
mod assets;
mod browser;
mod change;
mod deployments;
mod episode;
mod episodes;
mod escape;
mod frames;
mod http1;
mod jobs;
mod machines;
mod middleware;
mod overview;
mod page_request;
mod paging;
mod plot;
mod refusal;
mod routes;
mod runs;
mod settings;
mod sheet;
mod shell;
mod sign_in;
#[cfg(test)]
mod testing;
#[cfg(test)]
mod tests;
mod text;
mod vitals;

use std::{sync::Arc, time::Duration};

use gleaner_edge::Tls;
use metrics_exporter_prometheus::PrometheusHandle;
use tokio::net::TcpListener;
use tokio_util::task::AbortOnDropHandle;

use self::browser::{Browser, SignedIn};
use crate::{
    access::{PageGuard, TokenCache},
    config::ConnectionsConfig,
    connections::connections,
    error::{Error, Result},
    service::Services,
    telemetry,
};

/// Connections in total, and from one address: a browser opens six, each for one request.
const CONNECTIONS: usize = 512;
const CONNECTIONS_PER_ADDRESS: usize = 128;
/// The interval of metrics upkeep, which bounds their memory while they are not read, and of loading a new score run
/// ahead of its first view.
const UPKEEP: Duration = Duration::from_secs(5);

/// The state shared by all pages.
struct AppState {
    services: Services,
    guard: PageGuard,
    signed_in: SignedIn,
    metrics: PrometheusHandle,
    /// The name of the browsers' cookie.
    cookie: String,
    /// Whether the connection to the browser is encrypted.
    encrypted: bool,
    /// Whether the pages are reachable from this machine only.
    loopback: bool,
}

/// Serves the pages until the returned handle is dropped.
///
/// # Errors
/// Internal when metrics cannot be set up or the address is gone.
pub(crate) fn open(
    services: Services,
    listener: TcpListener,
    tls: Option<Arc<Tls>>,
    tokens: TokenCache,
) -> Result<AbortOnDropHandle<()>> {
    let metrics = telemetry::metrics::recorder()?;
    let address = listener.local_addr().map_err(|error| Error::internal("asking the pages' address", error))?;
    let (config, loopback) = (&services.config, address.ip().is_loopback());
    let required = config.access.tokens_required(loopback && config.listen.ip().is_loopback(), config.insecure);
    let connections = connections(&ConnectionsConfig {
        max_connections: CONNECTIONS,
        max_connections_per_address: CONNECTIONS_PER_ADDRESS,
        ..config.connections.clone()
    });
    let (encrypted, cookie) = (tls.is_some(), Browser::cookie_name(address.port()));
    let guard = PageGuard::new(tokens, services.store.clone(), required, connections.clone());
    let state =
        Arc::new(AppState { services, guard, signed_in: SignedIn::default(), metrics, cookie, encrypted, loopback });
    Ok(AbortOnDropHandle::new(tokio::spawn(async move {
        let pages = routes::all(&state);
        tokio::select! {
            () = http1::serve(connections, listener, tls, pages) => {}
            () = keep_up(&state) => {}
        }
    })))
}

/// Runs the periodic work of the pages.
async fn keep_up(state: &AppState) {
    loop {
        state.metrics.run_upkeep();
        if let Err(error) = state.services.curation.warm().await {
            tracing::warn!(%error, "loading the newest score run ahead failed");
        }
        tokio::time::sleep(UPKEEP).await;
    }
}
