//! The gleaner server. `run` builds the services, passes each its dependencies, and serves until it is stopped.
//!
//! Floors: `service` and `wire` over `ingest`, `imports`, `jobs`, `policies` and `scorers` over `store` and `blobs` over `domain`
//! and `error`. Calls go down, never up. Workers are processes of another program, `crates/worker`, and clients of this
//! server.

pub mod access;
mod blocking;
pub mod config;
mod connections;
mod curation;
mod imports;
pub mod ingest;
pub mod jobs;
pub mod maintenance;
mod model_cache;
mod openpi;
mod pages;
pub mod policies;
pub mod program;
pub mod rollouts;
mod scorers;
pub mod service;
pub mod shutdown;
pub mod store;
pub mod telemetry;
mod wire;

pub use gleaner_core::{self as domain, error};
pub use gleaner_data_folder::{self as data_folder, blobs, fail_point, file_limit, lock};

#[cfg(feature = "fuzzing")]
#[doc(hidden)]
pub use wire::fuzzing;

use std::{
    io,
    net::{Ipv4Addr, SocketAddr},
    sync::Arc,
};

use gleaner_edge::Tls;
use tokio::net::{TcpListener, TcpSocket};

use crate::{
    access::{TokenCache, tls},
    config::ServeConfig,
    error::{Error, Result},
    lock::{DataLock, StandbyLock},
    service::Services,
};

/// The addresses to serve on, bound.
#[derive(Debug)]
pub struct Listeners {
    calls: TcpListener,
    /// The TLS settings; `None`: calls are not encrypted.
    tls: Option<Arc<Tls>>,
    /// The listener for workers alone: on the loopback address and without TLS, unless they run on other machines.
    workers: TcpListener,
    /// The TLS settings of that listener, which checks no certificates of workers.
    worker_tls: Option<Arc<Tls>>,
    pages: Option<TcpListener>,
    /// The listener for clients of openpi.
    openpi: Option<TcpListener>,
}

impl Listeners {
    /// Binds the configured addresses, and reads the certificate.
    ///
    /// # Errors
    /// Precondition when an address is taken or not available, or the certificate cannot be used.
    pub async fn bind(config: &ServeConfig) -> Result<Self> {
        let tls = tls::open(&config.access)?;
        let (workers, worker_tls) = match config.jobs.engine.worker_listen {
            Some(address) => (bind("--worker-listen", address)?, tls::open_for_workers(&config.access)?),
            None => {
                (listen((Ipv4Addr::LOCALHOST, 0).into()).map_err(|error| Error::internal("listening", error))?, None)
            }
        };
        let bound = |flag, address: Option<SocketAddr>| address.map(|address| bind(flag, address)).transpose();
        let pages = bound("--web-listen", config.telemetry.web_listen)?;
        let openpi = bound("--openpi-listen", config.openpi.openpi_listen)?;
        Ok(Self { calls: bind("--listen", config.listen)?, tls, workers, worker_tls, pages, openpi })
    }

    /// The address for calls.
    ///
    /// # Errors
    /// Internal when the system does not return it.
    pub fn address(&self) -> Result<SocketAddr> {
        self.calls.local_addr().map_err(|error| Error::internal("reading the address of calls", error))
    }

    /// The address for calls, as a URL for clients.
    ///
    /// # Errors
    /// Internal when the system does not return it.
    pub fn url(&self) -> Result<String> {
        let scheme = if self.tls.is_some() { "https" } else { "http" };
        Ok(format!("{scheme}://{}", self.address()?))
    }

    /// The address of the pages, as a URL for browsers; `None` without pages.
    ///
    /// # Errors
    /// Internal when the system does not return it.
    pub fn pages_url(&self) -> Result<Option<String>> {
        let scheme = if self.tls.is_some() { "https" } else { "http" };
        Ok(self.pages()?.map(|pages| format!("{scheme}://{pages}")))
    }

    /// The address for clients of openpi, as a URL; `None` without one.
    ///
    /// # Errors
    /// Internal when the system does not return it.
    pub fn openpi_url(&self) -> Result<Option<String>> {
        let scheme = if self.tls.is_some() { "wss" } else { "ws" };
        let address = self.openpi.as_ref().map(TcpListener::local_addr).transpose();
        let address = address.map_err(|error| Error::internal("reading openpi's address", error))?;
        Ok(address.map(|address| format!("{scheme}://{address}")))
    }

    /// The address for the server's own workers.
    fn for_workers(&self) -> Result<SocketAddr> {
        self.workers.local_addr().map_err(|error| Error::internal("reading the workers' address", error))
    }

    fn pages(&self) -> Result<Option<SocketAddr>> {
        let pages = self.pages.as_ref().map(TcpListener::local_addr).transpose();
        pages.map_err(|error| Error::internal("reading the pages' address", error))
    }
}

/// Connections that the system may queue until they are accepted. The system's default is small; a connection beyond it
/// looks open to its client and is never served.
const BACKLOG: u32 = 4096;

/// A listener on the address of a flag.
fn bind(flag: &str, address: SocketAddr) -> Result<TcpListener> {
    listen(address).map_err(|error| {
        let taken = "; another program, or another gleaner-server, has this address: name another";
        let remedy = if error.kind() == io::ErrorKind::AddrInUse { taken } else { "" };
        Error::precondition(format!("{flag}: cannot listen on {address}: {error}{remedy}"))
    })
}

fn listen(address: SocketAddr) -> io::Result<TcpListener> {
    let socket = if address.is_ipv4() { TcpSocket::new_v4() } else { TcpSocket::new_v6() }?;
    // A restarted server need not wait for the old connections of the previous one.
    socket.set_reuseaddr(true)?;
    socket.bind(address)?;
    socket.listen(BACKLOG)
}

/// Serves on `listeners` until `stop` completes, then drains: open calls get time to end, and jobs are stopped to
/// resume later. `lock`, of the data directory, is held until the end; a standby begins without it, and takes it when the
/// leader is gone.
///
/// # Errors
/// When the data directory, the database or a listener cannot be used.
pub async fn run(
    mut config: ServeConfig,
    mut lock: Option<DataLock>,
    mut listeners: Listeners,
    stop: impl Future<Output = ()> + Send,
) -> Result<()> {
    let address = listeners.address()?;
    // The port that was bound, which standbys name to their callers.
    config.listen = address;
    tracing::info!(server.address = %address, data.dir = %config.data_dir.display(), "starting");
    gleaner_edge::raise_descriptor_limit();
    if listeners.pages.is_some() {
        // Installed before any metric is counted.
        telemetry::metrics::recorder()?;
    }
    if config.standby && lock.is_some() && service::standby::has_leader(&config).await? {
        lock = None;
    }
    // Of this process until it ends: files of its own are there when it takes the lead.
    let _among_standbys = lock.is_none().then(|| StandbyLock::join(&config.data_dir)).transpose()?;
    let services = match &lock {
        Some(_) => Services::open(config, listeners.for_workers()?).await?,
        None => Services::follow(config, listeners.for_workers()?).await?,
    };
    let (tokens, refreshing) = TokenCache::open_refreshed(services.store.clone()).await?;
    let (pages, openpi, tls) = (listeners.pages.take(), listeners.openpi.take(), listeners.tls.clone());
    let _openpi =
        openpi.map(|listener| openpi::open(services.clone(), listener, tls.clone(), tokens.clone())).transpose()?;
    let _pages = pages.map(|listener| pages::open(services.clone(), listener, tls, tokens.clone())).transpose()?;
    let leading = async {
        if lock.is_none() {
            service::standby::take_over(&services, &mut lock).await?;
        }
        std::future::pending::<Result<()>>().await
    };
    let served = tokio::select! {
        served = service::serve(&services, listeners, tokens, stop) => served,
        failed = leading => failed,
    };
    // Its next read would find the database closed.
    drop(refreshing);
    services.close().await;
    tracing::info!("stopped");
    served
}
