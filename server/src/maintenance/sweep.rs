//! The sweep: restores trash that a row names, deletes trash that is old enough, moves blobs without a row to the trash,
//! and removes unneeded files and uploads.
//!
//! It never races an upload or a job. A blob is removed under a lock that excludes storing a blob and committing its
//! row (`blobs::hold`), and only after the rows were read under that lock. A blob without a row may still get one from
//! a worker, which is another process, so it must also be older than a day and than every running attempt.
//!
//! Ages are measured by the time during which the database was in use (`store::clock`), so a clock that jumps removes
//! no data. A sweep that finds more than a small share of the blobs without a row stops before it removes any blob: the
//! database then probably belongs to other blobs.

use std::{
    collections::HashSet,
    path::Path,
    time::{Duration, SystemTime},
};

use super::{Sweeper, caches::Rules, describe::describe_queued, files, worth};
use crate::{
    blobs::{Blobs, Removing},
    blocking::off_runtime,
    domain::{
        description::Description,
        id::{BlobId, EpisodeId},
        time::Millis,
    },
    error::{Error, Kind, Result},
    store::Store,
};

/// Days for which files without a row are not touched.
const SAFE_DAYS: u32 = 1;
/// The number of blobs that one sweep may move to the trash whatever their share.
const FEW: usize = 8;
/// Longer than the lag of file times, which follow a coarser clock.
const FILES_LAG: Duration = Duration::from_secs(1);
const DAY: Duration = Duration::from_secs(24 * 60 * 60);

/// The counts of a sweep.
#[derive(Debug, Default, PartialEq, Eq)]
pub(super) struct SweepCounts {
    pub(super) episodes: u64,
    pub(super) purged: u64,
    /// Deleted blobs, and their bytes.
    pub(super) blobs: u64,
    pub(super) bytes: u64,
    /// Blobs without a row, moved to the trash.
    pub(super) trashed: u64,
    pub(super) caches: u64,
    pub(super) uploads: u64,
    /// Files left in `tmp` by killed processes.
    pub(super) leavings: u64,
    /// Logs of jobs without recent lines.
    pub(super) logs: u64,
    /// Entries of the audit log.
    pub(super) audited: u64,
}

impl Sweeper {
    /// Sweeps once, with `now` as the present time.
    ///
    /// # Errors
    /// Precondition when too large a share of the blobs has no row, which stay then, as the trash does; the rest was swept.
    /// When the database or the disk fails.
    pub(super) async fn sweep(&self, now: SystemTime) -> Result<SweepCounts> {
        let mut counts = SweepCounts::default();
        self.restore_named().await?;
        // Without this, recordings whose deletion is not yet in the sidecars would stay permanently.
        describe_queued(&self.store, &self.blobs).await?;
        let old = self.old_enough(now).await?;
        // Where the blobs may belong to another database, neither they nor what its users deleted is removed; all else is due.
        let foreign = match self.orphans(old).await {
            Err(error) if error.kind() == Kind::Precondition => Some(error),
            orphans => self.empty_trash((&orphans?, now, old), &mut counts).await.map(|()| None)?,
        };
        let blobs = self.blobs.clone();
        counts.leavings = off_runtime("sweeping", move || blobs.remove_drafts(old)).await?;
        let named = self.store.named_blobs().await?;
        let rules = Rules {
            blobs: self.blobs.clone(),
            named: named.into_iter().map(|named| named.blob).collect(),
            old,
            features_used: self.days_before(now, self.maintenance.features_days).await?,
        };
        counts.caches = off_runtime("sweeping", move || rules.sweep()).await?;
        let tmp = self.data_dir.join("tmp");
        counts.leavings += off_runtime("sweeping", move || remove_unwritten(&tmp, old)).await?;
        let logs = gleaner_data_folder::logs(&self.data_dir);
        // Running jobs may write to their logs, however rarely.
        let quiet = self.days_before(now, self.maintenance.log_days).await?.min(old);
        counts.logs = off_runtime("sweeping", move || remove_unwritten(&logs, quiet)).await?;
        let jumped = self.store.jumped_within(self.ingest.keep_for()).await?;
        counts.uploads = self.ingest.forget_abandoned(earlier(now, jumped)).await?;
        if let Some(days) = self.maintenance.audit_days {
            counts.audited = self.store.forget_audit(Millis::of(self.days_before(now, days).await?)).await?;
        }
        let exported = self.forget_exports(now, old).await?;
        (counts.blobs, counts.bytes) = (counts.blobs + exported.files, counts.bytes + exported.bytes);
        foreign.map_or(Ok(counts), Err)
    }

    /// Removes what was deleted long enough ago, and moves `orphans` to the trash.
    async fn empty_trash(
        &self,
        (orphans, now, old): (&[BlobId], SystemTime, SystemTime),
        counts: &mut SweepCounts,
    ) -> Result<()> {
        let trash_end = self.days_before(now, self.maintenance.trash_days).await?;
        let swept = self.store.sweep_trash(Millis::of(trash_end)).await?;
        (counts.episodes, counts.purged) = (swept.removed, swept.purged);
        for (episode, recording) in &swept.episodes {
            // Workers make no recordings: the recording of a deleted episode can be removed at once.
            counts.removed(forget_episode(&self.store, &self.blobs, episode, recording).await?);
        }
        let blobs = self.blobs.clone();
        let (deleted, bytes) = off_runtime("sweeping", move || blobs.empty_trash(trash_end, worth::stays)).await?;
        (counts.blobs, counts.bytes) = (counts.blobs + deleted, counts.bytes + bytes);
        self.discard(orphans, old, counts).await
    }

    /// Restores the blobs in the trash that a row names and that exist nowhere else: another database, since replaced, had
    /// no row for them.
    async fn restore_named(&self) -> Result<()> {
        let blobs = self.blobs.clone();
        let trash = off_runtime("sweeping", move || blobs.list_trash()).await?;
        for id in trash.into_iter().filter_map(|found| found.id) {
            if !self.store.names_blob(&id).await? {
                continue;
            }
            let (blobs, named) = (self.blobs.clone(), id.clone());
            if off_runtime("sweeping", move || Ok(blobs.size(&named)?.is_none() && blobs.take_back(&named)?)).await? {
                tracing::warn!(blob.id = %id, "a row names a blob in the trash that exists nowhere else: restored");
            }
        }
        Ok(())
    }

    /// The time the given number of days before `now`, not counting jumps of the clock.
    pub(super) async fn days_before(&self, now: SystemTime, days: u32) -> Result<SystemTime> {
        let age = DAY.saturating_mul(days);
        let jumped = self.store.jumped_within(age).await?;
        Ok(earlier(now, age.saturating_add(jumped)))
    }

    /// Files stored before this time have their rows, if they get any.
    async fn old_enough(&self, now: SystemTime) -> Result<SystemTime> {
        let day = self.days_before(now, SAFE_DAYS).await?;
        let running = self.store.oldest_running().await?.map(|begun| begun.time() - FILES_LAG);
        Ok(running.map_or(day, |running| running.min(day)))
    }

    /// The blobs older than `old` without a row.
    ///
    /// # Errors
    /// Precondition when they are too large a share of all blobs.
    async fn orphans(&self, old: SystemTime) -> Result<Vec<BlobId>> {
        let named = self.store.named_blobs().await?;
        let named: HashSet<BlobId> = named.into_iter().map(|named| named.blob).collect();
        let blobs = self.blobs.clone();
        let found = off_runtime("sweeping", move || blobs.list()).await?;
        let all = found.iter().filter(|found| found.id.is_some()).count();
        let mut orphans = found;
        orphans.retain(|found| found.placed < old && found.id.as_ref().is_some_and(|id| !named.contains(id)));
        let blobs = self.blobs.clone();
        let (orphans, unexplained) = off_runtime("sweeping", move || {
            let unexplained = orphans.iter().filter(|found| worth::is_unexplained(&blobs, found)).count();
            Ok((orphans, unexplained))
        })
        .await?;
        #[expect(clippy::cast_precision_loss, reason = "a share")]
        let share = unexplained as f64 / all.max(1) as f64;
        if unexplained > FEW && share > self.maintenance.max_sweep_share {
            return Err(Error::precondition(format!(
                "the database names {} of {all} blobs only, and the sweep would move {unexplained} recordings and \
                 results to the trash: above --max-sweep-share {}. All of these stay. `gleaner-server check` lists \
                 them; `gleaner-server rebuild` adds recordings that the database lacks; a larger --max-sweep-share \
                 allows it",
                all - orphans.len(),
                self.maintenance.max_sweep_share
            )));
        }
        Ok(orphans.into_iter().filter_map(|found| found.id).collect())
    }

    /// Moves blobs without a row to the trash.
    async fn discard(&self, orphans: &[BlobId], old: SystemTime, counts: &mut SweepCounts) -> Result<()> {
        for id in orphans {
            // The blob may have been stored again since it was listed, before its row.
            let (blobs, again) = (self.blobs.clone(), id.clone());
            let placed = off_runtime("sweeping", move || blobs.placed(&again)).await?;
            if placed.is_none_or(|placed| placed >= old) {
                continue;
            }
            let Some(removing) = self.blobs.removing().await? else { continue };
            if self.store.names_blob(id).await? {
                continue;
            }
            let (blobs, moved) = (self.blobs.clone(), id.clone());
            let size = off_runtime("sweeping", move || blobs.discard(&moved, &removing)).await?;
            tracing::info!(blob.id = %id, blob.bytes = size, "no row names a blob: it moves to the trash");
            counts.trashed += u64::from(size.is_some());
        }
        Ok(())
    }
}

fn earlier(now: SystemTime, by: Duration) -> SystemTime {
    now.checked_sub(by).unwrap_or(SystemTime::UNIX_EPOCH)
}

/// Removes files without recent writes, and returns their number.
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

/// The last time that a file, or any file in a folder, was written.
fn written(path: &Path) -> std::io::Result<SystemTime> {
    let mut newest = std::fs::symlink_metadata(path)?.modified()?;
    if path.is_dir() {
        for entry in std::fs::read_dir(path)? {
            newest = newest.max(entry?.metadata()?.modified()?);
        }
    }
    Ok(newest)
}

impl SweepCounts {
    fn removed(&mut self, bytes: Option<u64>) {
        if let Some(bytes) = bytes {
            self.blobs += 1;
            self.bytes += bytes;
        }
    }
}

/// Removes a blob of a job unless a row names it, and returns its size. A blob with a description moves to the trash
/// instead. During a copy of the data folder the blob stays, for a later sweep.
///
/// # Errors
/// When the database or the disk fails.
pub(crate) async fn forget(store: &Store, blobs: &Blobs, blob: &BlobId) -> Result<Option<u64>> {
    let Some(removing) = unneeded(store, blobs, blob).await? else { return Ok(None) };
    let (blobs, id) = (blobs.clone(), blob.clone());
    off_runtime("sweeping", move || match blobs.descriptions(&id)?.is_empty() {
        true => blobs.remove(&id, &removing),
        false => blobs.discard(&id, &removing),
    })
    .await
}

/// Removes the recording of an episode whose row is deleted, unless another row names it, and then its description. A
/// recording whose description is not marked as deleted moves to the trash: the row then belongs to an older copy of
/// the database.
///
/// # Errors
/// When the database or the disk fails.
pub(super) async fn forget_episode(
    store: &Store,
    blobs: &Blobs,
    episode: &EpisodeId,
    recording: &BlobId,
) -> Result<Option<u64>> {
    let removing = unneeded(store, blobs, recording).await?;
    let shared = removing.is_none() && store.names_blob(recording).await?;
    let (blobs, id, episode) = (blobs.clone(), recording.clone(), episode.clone());
    off_runtime("sweeping", move || {
        let described = blobs.description(&id, episode.as_str()).and_then(|json| Description::read(&json));
        let deleted = described.is_none_or(|description| description.is_deleted_recording());
        match removing {
            Some(removing) if deleted => {
                let size = blobs.remove(&id, &removing)?;
                blobs.forget_description(&id, episode.as_str())?;
                Ok(size)
            }
            Some(removing) => blobs.discard(&id, &removing),
            None if shared && deleted => blobs.forget_description(&id, episode.as_str()).map(|()| None),
            // During a copy the description stays, because it explains the blob to later sweeps.
            None => Ok(None),
        }
    })
    .await
}

/// The permission to remove a blob; `None` while a row names it or a backup copies the data folder.
async fn unneeded(store: &Store, blobs: &Blobs, blob: &BlobId) -> Result<Option<Removing>> {
    let Some(removing) = blobs.removing().await? else {
        tracing::debug!(blob.id = %blob, "an unneeded blob stays while the data folder is copied");
        return Ok(None);
    };
    Ok(if store.names_blob(blob).await? { None } else { Some(removing) })
}
