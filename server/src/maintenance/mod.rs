//! Maintenance of a data folder: checking it (`check`), copying it (`backup`, `restore`), rebuilding its database
//! (`rebuild`), moving its database (`migrate`), and removing unneeded data (the sweep).
//!
//! The commands work on the folder from outside, with or without a running server. Must not depend on models or wire
//! types.

mod backup;
mod caches;
mod check;
mod describe;
mod exports;
mod files;
mod manifest;
mod migrate;
mod rebuild;
mod report;
mod restore;
mod sweep;
mod target;
#[cfg(test)]
mod tests;
mod watch;
mod worth;

use std::{
    io::Write,
    path::PathBuf,
    sync::Arc,
    time::{Duration, Instant, SystemTime},
};

use tokio_util::{sync::CancellationToken, task::TaskTracker};

pub(crate) use self::sweep::forget;
use crate::{
    blobs::Blobs,
    config::{MaintenanceCommand, MaintenanceConfig, ServeConfig},
    domain::time::Millis,
    error::Result,
    ingest::Ingest,
    store::Store,
};

/// The interval of sweeps. The first one is at the start.
const SWEEP_EVERY: Duration = Duration::from_secs(60 * 60);

/// Runs one of the commands and writes its result to `out`; true when there is no problem.
///
/// # Errors
/// Precondition when the command's arguments do not fit the folder; Exhausted when a disk is full; Internal when one
/// fails.
pub async fn run(command: &MaintenanceCommand, out: &mut impl Write) -> Result<bool> {
    match command {
        MaintenanceCommand::Check(config) => check::check(config, out).await,
        MaintenanceCommand::Backup(config) => backup::backup(config, out).await,
        MaintenanceCommand::Restore(config) => restore::restore(config, out).await,
        MaintenanceCommand::Rebuild(config) => rebuild::rebuild(config, out).await,
        MaintenanceCommand::Migrate(config) => migrate::migrate(config, out).await.map(|()| true),
    }
}

/// The maintenance of a running server.
#[derive(Clone)]
pub struct Maintenance {
    tasks: TaskTracker,
    stopping: CancellationToken,
}

/// The resources of a sweep.
struct Sweeper {
    store: Store,
    blobs: Blobs,
    ingest: Ingest,
    data_dir: PathBuf,
    maintenance: MaintenanceConfig,
}

impl Maintenance {
    /// The maintenance of a folder that another server maintains yet.
    pub(crate) fn new() -> Self {
        Self { tasks: TaskTracker::new(), stopping: CancellationToken::new() }
    }

    /// Sweeps periodically until it is stopped.
    pub(crate) fn begin(&self, config: &Arc<ServeConfig>, store: Store, blobs: Blobs, ingest: Ingest) {
        let (data_dir, maintenance) = (config.data_dir.clone(), config.maintenance.clone());
        self.spawn(watch::watch_disk(blobs.clone()));
        self.spawn(watch::watch_files(store.clone(), data_dir.clone()));
        self.spawn(describe::keep_described(store.clone(), blobs.clone()));
        let sweeper = Sweeper { store, blobs, ingest, data_dir, maintenance };
        self.spawn(async move {
            let mut noted: Option<Instant> = None;
            loop {
                // Ages are unknown until the clock is recorded.
                if sweeper.note_time(noted.map(|noted| noted.elapsed())).await {
                    noted = Some(Instant::now());
                    sweeper.sweep_and_log().await;
                }
                tokio::time::sleep(SWEEP_EVERY).await;
            }
        });
    }

    /// Starts a background task that runs until the server stops. Each task may be interrupted at any point and resumes
    /// at the next start.
    fn spawn(&self, forever: impl Future<Output = ()> + Send + 'static) {
        let stopped = self.stopping.clone();
        self.tasks.spawn(async move {
            let _: Option<()> = stopped.run_until_cancelled(forever).await;
        });
    }

    /// Stops the tasks and waits for them.
    pub(crate) async fn stop(&self) {
        self.stopping.cancel();
        self.tasks.close();
        self.tasks.wait().await;
    }
}

impl Sweeper {
    /// Records the clock and returns whether that succeeded. `ran`: the time that the server has run since the last
    /// record.
    async fn note_time(&self, ran: Option<Duration>) -> bool {
        let noted = self.store.note_time(Millis::now(), ran).await;
        match &noted {
            Ok(None) => {}
            Ok(Some(jump)) => tracing::warn!(
                clock.jump_days = jump.as_secs() / (24 * 60 * 60),
                "the clock is ahead of the time that the database has recorded: it jumped, or the server was off. Age \
                 limits count only the time that the server has measured"
            ),
            Err(error) => tracing::error!(%error, "the clock could not be noted, so the sweep is skipped until later"),
        }
        noted.is_ok()
    }

    async fn sweep_and_log(&self) {
        match self.sweep(SystemTime::now()).await {
            Ok(counts) if counts == sweep::SweepCounts::default() => {}
            Ok(counts) => tracing::info!(
                episodes.removed = counts.episodes,
                episodes.purged = counts.purged,
                blobs.removed = counts.blobs,
                blobs.bytes = counts.bytes,
                blobs.moved_to_trash = counts.trashed,
                caches.removed = counts.caches,
                uploads.forgotten = counts.uploads,
                leavings.removed = counts.leavings,
                logs.removed = counts.logs,
                audit.forgotten = counts.audited,
                "swept"
            ),
            Err(error) => tracing::error!(%error, "the sweep failed and will be retried"),
        }
    }
}
