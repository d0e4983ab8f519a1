//! The curation pages, for people, and what programs ask for, on an address of their own.
//!
//! Another face of the same rooms as `service`, behind the same table of roles. Knows HTTP and HTML; must not know gRPC,
//! SQL or tensors. No page without a row in the authorisation table, no handler without the middleware.

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
mod made;
mod middleware;
mod overview;
mod paging;
mod plot;
mod refusal;
mod routes;
mod runs;
mod say;
mod settings;
mod sheet;
mod shell;
mod sign_in;
#[cfg(test)]
mod testing;
#[cfg(test)]
mod tests;
mod visit;
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
    service::Rooms,
    telemetry,
};

/// Connections at once, and from one address: a browser opens six, each for one request.
const CONNECTIONS: usize = 512;
const CONNECTIONS_PER_ADDRESS: usize = 128;
/// How often what was measured is summed up, so that it does not pile up when nobody looks; and a new score run, so that
/// who looks first need not wait.
const UPKEEP: Duration = Duration::from_secs(5);

/// What every page may look at.
struct House {
    rooms: Rooms,
    guard: PageGuard,
    signed_in: SignedIn,
    metrics: PrometheusHandle,
    /// The name of the cookie that browsers come back with.
    cookie: String,
    /// Whether the way to the browser is encrypted.
    encrypted: bool,
    /// Whether only this machine reaches the pages.
    loopback: bool,
}

/// Opens the pages, until what this gives is dropped.
///
/// # Errors
/// Internal when metrics cannot be set up or the address is gone.
pub(crate) fn open(
    rooms: Rooms,
    listener: TcpListener,
    tls: Option<Arc<Tls>>,
    tokens: TokenCache,
) -> Result<AbortOnDropHandle<()>> {
    let metrics = telemetry::metrics::recorder()?;
    let address = listener.local_addr().map_err(|error| Error::internal("asking the pages' address", error))?;
    let (config, loopback) = (&rooms.config, address.ip().is_loopback());
    let required = config.access.tokens_required(loopback && config.listen.ip().is_loopback(), config.insecure);
    let connections = connections(&ConnectionsConfig {
        max_connections: CONNECTIONS,
        max_connections_per_address: CONNECTIONS_PER_ADDRESS,
        ..config.connections.clone()
    });
    let (encrypted, cookie) = (tls.is_some(), Browser::cookie_name(address.port()));
    let guard = PageGuard::new(tokens, rooms.store.clone(), required, connections.clone());
    let house = Arc::new(House { rooms, guard, signed_in: SignedIn::default(), metrics, cookie, encrypted, loopback });
    Ok(AbortOnDropHandle::new(tokio::spawn(async move {
        let pages = routes::all(&house);
        tokio::select! {
            () = http1::serve(connections, listener, tls, pages) => {}
            () = keep_up(&house) => {}
        }
    })))
}

/// Does again and again what need not wait until somebody looks.
async fn keep_up(house: &House) {
    loop {
        house.metrics.run_upkeep();
        if let Err(error) = house.rooms.curation.warm().await {
            tracing::warn!(%error, "the newest score run was not summed up ahead");
        }
        tokio::time::sleep(UPKEEP).await;
    }
}
