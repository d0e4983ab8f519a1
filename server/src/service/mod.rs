//! The gRPC services: one thin method for each rpc, and the modules that all of them share.

mod answer;
mod dataset;
mod download;
mod episode;
mod health;
mod import;
mod inference;
mod job;
mod policy;
mod schedule;
mod score;
mod scoring;
mod segment;
mod serve;
mod shutdown;
mod snapshot;
pub(crate) mod standby;
mod subjects;
mod task;
#[cfg(test)]
mod tests;
mod worker;

use std::{net::SocketAddr, sync::Arc};

use tokio_util::sync::CancellationToken;

pub(crate) use self::serve::serve;
use crate::{
    blobs::{self, Blobs},
    config::ServeConfig,
    curation::Curation,
    data_folder,
    domain::id::TaskId,
    error::{Error, Result},
    ingest::Ingest,
    jobs::Jobs,
    maintenance::Maintenance,
    policies::Policies,
    rollouts::Rollouts,
    scorers::Scorers,
    store::{Database, Store},
};

/// Every module that a service may call, built once.
#[derive(Clone)]
pub struct Services {
    pub(crate) config: Arc<ServeConfig>,
    pub(crate) store: Store,
    pub(crate) blobs: Blobs,
    pub(crate) curation: Curation,
    pub(crate) ingest: Ingest,
    pub(crate) jobs: Jobs,
    pub(crate) maintenance: Maintenance,
    pub(crate) policies: Policies,
    pub(crate) rollouts: Rollouts,
    pub(crate) scorers: Scorers,
    /// Cancelled when the server begins to stop, which ends streams that would stay open.
    pub(crate) stopping: CancellationToken,
}

impl Services {
    /// Opens the data directory, repairs it after a crash, and starts the supervisor of workers.
    ///
    /// # Errors
    /// When the data directory or the database cannot be used.
    pub async fn open(config: ServeConfig, address: SocketAddr) -> Result<Self> {
        let config = Arc::new(config);
        let (data_dir, bucket) = (config.data_dir.clone(), config.blob_store.bucket());
        let settling = tokio::task::spawn_blocking(move || blobs::settle(&data_dir, bucket));
        settling.await.map_err(|error| Error::internal("opening the blob store", error))??;
        let blobs = Blobs::open(&config.data_dir)?
            .sparing(config.maintenance.min_free_bytes)
            .limiting_caches(config.maintenance.max_cache_bytes)?;
        let accept = config.maintenance.accept_database;
        let database = Database::configured(&config.data_dir, &config.database)?.of_server(config.listen);
        tracing::info!(%database, "opening the database");
        let store = Store::open_with_blobs(&database, &blobs, accept).await?;
        let services = Self::new(config, store, blobs, address)?;
        services.begin().await?;
        Ok(services)
    }

    /// Opens the data folder and the database of another server, which leads.
    ///
    /// # Errors
    /// When they cannot be used, or do not belong together.
    pub(crate) async fn follow(config: ServeConfig, address: SocketAddr) -> Result<Self> {
        let config = Arc::new(config);
        let blobs = Blobs::open(&config.data_dir)?
            .sparing(config.maintenance.min_free_bytes)
            .limiting_caches(config.maintenance.max_cache_bytes)?;
        let (database, at) = standby::database(&config)?;
        tracing::info!(%database, "following the leader of the database");
        let store = Store::follow(&at, &database, &blobs).await?;
        Self::new(config, store, blobs, address)
    }

    /// Every module, without repairs and without work of its own.
    fn new(config: Arc<ServeConfig>, store: Store, blobs: Blobs, address: SocketAddr) -> Result<Self> {
        data_folder::access::warn_if_open(&config.data_dir);
        let ingest = Ingest::new(&config, store.clone(), blobs.clone())?;
        let curation = Curation::new(store.clone(), ingest.clone());
        let jobs = Jobs::new(&config, store.clone(), blobs.clone(), address)?;
        let scorers = Scorers::new(config.policies.live_scorers, store.clone(), blobs.clone(), ingest.clone());
        let rollouts = Rollouts::new(&config, ingest.clone());
        let policies = Policies::new(&config, store.clone(), blobs.clone(), scorers.clone(), rollouts.clone());
        let maintenance = Maintenance::new();
        Ok(Self {
            config,
            store,
            blobs,
            curation,
            ingest,
            jobs,
            maintenance,
            policies,
            rollouts,
            scorers,
            stopping: CancellationToken::new(),
        })
    }

    /// Repairs what an earlier server has left, and starts the work of the server that leads.
    ///
    /// # Errors
    /// When the data directory or the database cannot be used.
    async fn begin(&self) -> Result<()> {
        self.ingest.recover().await?;
        self.jobs.begin().await?;
        self.rollouts.begin_storing()?;
        self.maintenance.begin(&self.config, self.store.clone(), self.blobs.clone(), self.ingest.clone());
        self.store.lead();
        Ok(())
    }

    /// The id of a task; `None` for an empty name, which stands for all tasks.
    ///
    /// # Errors
    /// NotFound.
    async fn task_or_all(&self, task: &str) -> Result<Option<TaskId>> {
        if task.is_empty() { Ok(None) } else { Ok(Some(self.store.task(task).await?.id)) }
    }

    /// Stops workers and models, then closes the database.
    pub async fn close(&self) {
        self.jobs.stop().await;
        self.maintenance.stop().await;
        self.policies.stop().await;
        self.rollouts.stop().await;
        self.scorers.stop().await;
        self.store.close().await;
    }
}
