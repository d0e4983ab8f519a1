//! The gleaner server. `run` builds the rooms, hands each what it needs, and serves until told to stop.
//!
//! Floors: `service` and `wire` over `ingest`, `jobs`, `policies` and `scorers` over `store` and `blobs` over `domain` and
//! `error`. Calls go down, never up. `worker` is the other process of this binary: a client of this server.

pub mod blobs;
pub mod config;
pub mod domain;
pub mod error;
pub mod ingest;
pub mod jobs;
pub mod lock;
pub mod policies;
pub mod rollouts;
mod scorers;
pub mod service;
pub mod shutdown;
pub mod store;
pub mod telemetry;
mod wire;
pub mod worker;

use std::{net::SocketAddr, time::Duration};

use tokio::net::TcpListener;

use crate::{
    config::ServeConfig,
    error::{Error, Result},
    lock::DataLock,
    service::Rooms,
};

/// Binds the address to serve on.
///
/// # Errors
/// Precondition when the address is taken or not ours.
pub async fn bind(address: SocketAddr) -> Result<TcpListener> {
    TcpListener::bind(address)
        .await
        .map_err(|error| Error::precondition(format!("cannot listen on {address}: {error}")))
}

/// Serves on `listener` until `stop` ends, then drains: open calls get a while, jobs are stopped to resume later.
/// `_lock`, of the data directory, is held until the end.
///
/// # Errors
/// When the data directory, the database or the listener cannot be used.
pub async fn run(
    config: ServeConfig,
    _lock: DataLock,
    listener: TcpListener,
    stop: impl Future<Output = ()> + Send,
) -> Result<()> {
    let address = listener.local_addr().map_err(|error| Error::internal("asking the address", error))?;
    tracing::info!(server.address = %address, data.dir = %config.data_dir.display(), "starting");
    let drain = Duration::from_secs(config.drain_seconds);
    let rooms = Rooms::open(config, address).await?;
    let served = service::serve(&rooms, listener, stop, drain).await;
    rooms.close().await;
    tracing::info!("stopped");
    served
}
