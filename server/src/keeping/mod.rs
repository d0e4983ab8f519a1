//! Keeping what a lab recorded: whether it is all there (`check`), a second place for it (`backup`, `restore`), and what
//! goes when nobody needs it (the sweep).
//!
//! The commands look at a data folder from outside, beside a running server or without one. Knows no model and no wire
//! type.

mod backup;
mod caches;
mod check;
mod describe;
mod files;
mod manifest;
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
    config::{KeepingCommand, KeepingConfig, ServeConfig},
    domain::time::Millis,
    error::Result,
    ingest::Ingest,
    store::Store,
};

/// How often a server sweeps. The first time is when it starts.
const SWEEP_EVERY: Duration = Duration::from_secs(60 * 60);

/// Runs one of the commands and tells `out` what came of it; true when nothing is wrong.
///
/// # Errors
/// Precondition when it cannot be done as asked; Exhausted when a disk is full; Internal when one refuses.
pub async fn run(command: &KeepingCommand, out: &mut impl Write) -> Result<bool> {
    match command {
        KeepingCommand::Check(config) => check::check(config, out).await,
        KeepingCommand::Backup(config) => backup::backup(config, out).await,
        KeepingCommand::Restore(config) => restore::restore(config, out).await,
        KeepingCommand::Rebuild(config) => rebuild::rebuild(config, out).await,
    }
}

/// What a server does for what it keeps, while it runs.
#[derive(Clone)]
pub struct Keeping {
    tasks: TaskTracker,
    stopping: CancellationToken,
}

/// What is kept.
struct Room {
    store: Store,
    blobs: Blobs,
    ingest: Ingest,
    data_dir: PathBuf,
    keeping: KeepingConfig,
}

impl Keeping {
    /// Sweeps now and then until it is stopped.
    pub(crate) fn start(config: &Arc<ServeConfig>, store: Store, blobs: Blobs, ingest: Ingest) -> Self {
        let (tasks, stopping) = (TaskTracker::new(), CancellationToken::new());
        let (data_dir, keeping) = (config.data_dir.clone(), config.keeping.clone());
        let kept = Self { tasks, stopping };
        kept.spawn(watch::watch_disk(blobs.clone()));
        kept.spawn(watch::watch_files(store.clone(), data_dir.clone()));
        kept.spawn(describe::keep_described(store.clone(), blobs.clone()));
        let room = Room { store, blobs, ingest, data_dir, keeping };
        kept.spawn(async move {
            let mut noted: Option<Instant> = None;
            loop {
                // Ages are unknown until the clock is noted.
                if room.note_time(noted.map(|noted| noted.elapsed())).await {
                    noted = Some(Instant::now());
                    room.sweep_and_tell().await;
                }
                tokio::time::sleep(SWEEP_EVERY).await;
            }
        });
        kept
    }

    /// Has something go on until the server stops. Each can be cut anywhere: the next start goes on with it.
    fn spawn(&self, forever: impl Future<Output = ()> + Send + 'static) {
        let stopped = self.stopping.clone();
        self.tasks.spawn(async move {
            let _: Option<()> = stopped.run_until_cancelled(forever).await;
        });
    }

    /// Ends the sweep and waits until it has.
    pub(crate) async fn stop(&self) {
        self.stopping.cancel();
        self.tasks.close();
        self.tasks.wait().await;
    }
}

impl Room {
    /// Notes the clock, and gives whether that was possible. `ran` is how long the server has run since it was noted
    /// before.
    async fn note_time(&self, ran: Option<Duration>) -> bool {
        let noted = self.store.note_time(Millis::now(), ran).await;
        match &noted {
            Ok(None) => {}
            Ok(Some(jump)) => tracing::warn!(
                clock.jump_days = jump.as_secs() / (24 * 60 * 60),
                "the clock is this far ahead of the time that the database has seen pass: it jumped, or the server was \
                 off. Nothing is removed for its age until that age has passed by the server's own count"
            ),
            Err(error) => tracing::error!(%error, "the clock was not noted, so nothing is swept; tried again later"),
        }
        noted.is_ok()
    }

    async fn sweep_and_tell(&self) {
        match self.sweep(SystemTime::now()).await {
            Ok(tally) if tally == sweep::Tally::default() => {}
            Ok(tally) => tracing::info!(
                episodes.removed = tally.episodes,
                episodes.purged = tally.purged,
                blobs.removed = tally.blobs,
                blobs.bytes = tally.bytes,
                blobs.moved_to_trash = tally.trashed,
                caches.removed = tally.caches,
                uploads.forgotten = tally.uploads,
                leavings.removed = tally.leavings,
                logs.removed = tally.logs,
                audit.forgotten = tally.audited,
                "swept"
            ),
            Err(error) => tracing::error!(%error, "the sweep broke off; it is tried again later"),
        }
    }
}
