//! The server behind the pages: implements the traits of `web` with the modules below. Must not know HTML or HTTP.

mod live_frame;
mod queries;
mod scores;
#[cfg(test)]
mod testing;
#[cfg(test)]
mod tests;
mod vitals;

use std::{sync::Arc, time::Duration};

use async_trait::async_trait;
use gleaner_edge::{Call, ConnectionState, Tls};
use gleaner_web::{Access, Backend, Caller, Disk, Machine, Site};
use metrics_exporter_prometheus::PrometheusHandle;
use tokio::net::TcpListener;
use tokio_util::task::AbortOnDropHandle;

use crate::{
    access::{self, PageGuard, TokenCache, token_hash},
    config::ConnectionsConfig,
    connections::{Connections, connections},
    domain::{access::AuditEntry, id::TokenId},
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
    let address = listener.local_addr().map_err(|error| Error::internal("reading the pages' address", error))?;
    let config = &services.config;
    let loopback = address.ip().is_loopback() && config.listen.ip().is_loopback();
    let required = config.access.tokens_required(loopback, config.insecure);
    let connections = connections(&ConnectionsConfig {
        max_connections: CONNECTIONS,
        max_connections_per_address: CONNECTIONS_PER_ADDRESS,
        ..config.connections.clone()
    });
    let pages = Arc::new(PageBackend::new(services, tokens, required, connections.clone())?);
    Ok(AbortOnDropHandle::new(tokio::spawn(async move {
        let site = Site::new(pages.clone(), connections, address, tls.is_some());
        tokio::select! {
            () = site.serve(listener, tls) => {}
            () = pages.keep_up() => {}
        }
    })))
}

/// The server as its pages use it.
struct PageBackend {
    services: Services,
    guard: PageGuard,
    metrics: PrometheusHandle,
}

impl PageBackend {
    fn new(services: Services, tokens: TokenCache, required: bool, connections: Connections) -> Result<Self> {
        let (guard, metrics) = (PageGuard::new(tokens, required, connections), telemetry::metrics::recorder()?);
        Ok(Self { services, guard, metrics })
    }

    /// Runs the periodic work of the pages.
    async fn keep_up(&self) {
        loop {
            self.metrics.run_upkeep();
            if let Err(error) = self.services.curation.warm().await {
                tracing::warn!(%error, "loading the newest score run ahead failed");
            }
            tokio::time::sleep(UPKEEP).await;
        }
    }
}

impl Backend for PageBackend {}

#[async_trait]
impl Access for PageBackend {
    fn token_hash(&self, token: &str) -> String {
        token_hash(token)
    }

    async fn admit(&self, hash: Option<&str>, connection: &ConnectionState) -> Result<(Call, Result<Caller>)> {
        let (call, caller) = self.guard.admit(hash, connection).await?;
        Ok((call, caller.map(of_pages)))
    }

    async fn authenticate(&self, hash: Option<&str>) -> Result<Caller> {
        self.guard.authenticate(hash).await.map(of_pages)
    }

    fn audits_rejection(&self, token: &TokenId) -> bool {
        self.guard.audits_rejection(token)
    }

    async fn audit(&self, entry: AuditEntry) {
        access::write_audit(self.services.store.clone(), entry).await;
    }
}

/// A caller as the pages know it.
fn of_pages(caller: access::Caller) -> Caller {
    match caller {
        access::Caller::Known(live) => Caller::Known { token: Arc::new(live.token.clone()), ended: live.ended() },
        access::Caller::Anyone => Caller::Anyone,
    }
}

#[async_trait]
impl Machine for PageBackend {
    fn health(&self) -> Result<()> {
        if self.services.stopping.is_cancelled() {
            return Err(Error::unavailable("stopping"));
        }
        self.services.store.verify()
    }

    async fn metrics(&self) -> Result<String> {
        vitals::sample(&self.services).await?;
        Ok(self.metrics.render())
    }

    async fn disk(&self) -> Result<Disk> {
        vitals::disk(&self.services).await
    }
}
