//! The sweep: takes out of the trash what has been there long enough, and removes files and uploads that nobody needs.
//!
//! It never races an upload or a job. A blob is removed under a lock that excludes whoever puts one in its place and
//! commits its row (`blobs::hold`), and only after the rows were asked under that lock. What no row names at all may
//! still be on its way from a worker, which is another process: so it must also be older than a day and than every
//! attempt that is running. What comes late is at worst put again, never named and gone.

use std::{
    collections::HashSet,
    path::Path,
    time::{Duration, SystemTime},
};

use super::{Room, caches::Rules, files};
use crate::{
    blobs::Blobs,
    domain::{id::BlobId, time::Millis},
    error::{Error, Result},
    jobs,
    store::Store,
};

/// Days for which files that no row names are left alone.
const SAFE_DAYS: u32 = 1;
/// More than files' times, which follow a coarser clock, lag behind.
const FILES_LAG: Duration = Duration::from_secs(1);
const DAY: Duration = Duration::from_secs(24 * 60 * 60);

/// What a sweep removed.
#[derive(Debug, Default, PartialEq, Eq)]
pub(super) struct Tally {
    pub(super) episodes: u64,
    pub(super) purged: u64,
    pub(super) blobs: u64,
    pub(super) bytes: u64,
    pub(super) caches: u64,
    pub(super) uploads: u64,
    /// What processes that were killed have left in `tmp`.
    pub(super) leavings: u64,
    /// Logs of jobs to which nothing was added for long.
    pub(super) logs: u64,
    /// Entries of the audit log.
    pub(super) audited: u64,
}

impl Room {
    /// Sweeps once, as if it were `now`.
    pub(super) async fn sweep(&self, now: SystemTime) -> Result<Tally> {
        let mut tally = Tally::default();
        let swept = self.store.sweep_trash(Millis::of(days_before(now, self.keeping.trash_days))).await?;
        (tally.episodes, tally.purged) = (swept.removed, swept.purged);
        for recording in &swept.recordings {
            // No worker makes recordings: what the trash gave up can go at once.
            tally.removed(forget(&self.store, &self.blobs, recording).await?);
        }
        let named = self.store.named_blobs().await?;
        let named: HashSet<BlobId> = named.into_iter().map(|named| named.blob).collect();
        let old = self.old_enough(now).await?;
        self.orphans(&named, old, &mut tally).await?;
        let rules = Rules {
            folder: self.data_dir.join("cache"),
            named,
            old,
            features_used: days_before(now, self.keeping.features_days),
            most_bytes: self.keeping.max_cache_bytes,
        };
        tally.caches = off_runtime(move || rules.sweep()).await?;
        let tmp = self.data_dir.join("tmp");
        tally.leavings = off_runtime(move || remove_unwritten(&tmp, old)).await?;
        let logs = jobs::logs_folder(&self.data_dir);
        // Those of jobs that run are being written, however seldom.
        let quiet = days_before(now, self.keeping.log_days).min(old);
        tally.logs = off_runtime(move || remove_unwritten(&logs, quiet)).await?;
        tally.uploads = self.ingest.forget_abandoned(now).await?;
        if let Some(days) = self.keeping.audit_days {
            tally.audited = self.store.forget_audit(Millis::of(days_before(now, days))).await?;
        }
        Ok(tally)
    }

    /// Before when a file must have been put to be sure that nobody is about to name it.
    async fn old_enough(&self, now: SystemTime) -> Result<SystemTime> {
        let day = days_before(now, SAFE_DAYS);
        let running = self.store.oldest_running().await?.map(|begun| begun.time() - FILES_LAG);
        Ok(running.map_or(day, |running| running.min(day)))
    }

    /// Removes the blobs that no row names.
    async fn orphans(&self, named: &HashSet<BlobId>, old: SystemTime, tally: &mut Tally) -> Result<()> {
        let blobs = self.blobs.clone();
        let found = off_runtime(move || blobs.list()).await?;
        for found in found.into_iter().filter(|found| found.placed < old) {
            let Some(id) = found.id.filter(|id| !named.contains(id)) else { continue };
            // It may have been put again since it was listed: the rows do not know that yet.
            let (blobs, again) = (self.blobs.clone(), id.clone());
            let placed = off_runtime(move || Ok(blobs.placed(&again))).await?;
            if placed.is_some_and(|placed| placed < old) {
                tally.removed(forget(&self.store, &self.blobs, &id).await?);
            }
        }
        Ok(())
    }
}

fn days_before(now: SystemTime, days: u32) -> SystemTime {
    now.checked_sub(DAY.saturating_mul(days)).unwrap_or(SystemTime::UNIX_EPOCH)
}

/// Removes what nobody has written to for long, and says how much there was.
fn remove_unwritten(folder: &Path, old: SystemTime) -> Result<u64> {
    let mut removed = 0;
    for path in files::entries(folder)? {
        if written(&path).is_ok_and(|at| at < old) {
            let is_folder = path.is_dir();
            let gone = if is_folder { std::fs::remove_dir_all(&path) } else { std::fs::remove_file(&path) };
            gone.map_err(|error| Error::internal(format!("removing {}", path.display()), error))?;
            removed += 1;
        }
    }
    Ok(removed)
}

/// When a file, or anything in a folder, was written last.
fn written(path: &Path) -> std::io::Result<SystemTime> {
    let mut newest = std::fs::symlink_metadata(path)?.modified()?;
    if path.is_dir() {
        for entry in std::fs::read_dir(path)? {
            newest = newest.max(entry?.metadata()?.modified()?);
        }
    }
    Ok(newest)
}

impl Tally {
    fn removed(&mut self, bytes: Option<u64>) {
        if let Some(bytes) = bytes {
            self.blobs += 1;
            self.bytes += bytes;
        }
    }
}

/// Removes a blob unless a row names it, and says how large it was. One that cannot go now, because somebody copies the
/// data folder, a later sweep finds.
///
/// # Errors
/// When the database or the disk refuses.
pub(crate) async fn forget(store: &Store, blobs: &Blobs, blob: &BlobId) -> Result<Option<u64>> {
    let Some(removing) = blobs.removing().await? else {
        tracing::debug!(blob.id = %blob, "a blob that nothing needs stays while the data folder is copied");
        return Ok(None);
    };
    if store.names_blob(blob).await? {
        return Ok(None);
    }
    let (blobs, id) = (blobs.clone(), blob.clone());
    off_runtime(move || blobs.remove(&id, &removing)).await
}

/// Runs what blocks away from the runtime's threads.
async fn off_runtime<T: Send + 'static>(work: impl FnOnce() -> Result<T> + Send + 'static) -> Result<T> {
    tokio::task::spawn_blocking(work).await.map_err(|error| Error::internal("sweeping", error))?
}
