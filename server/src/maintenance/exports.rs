//! Removes the files of exports that are no longer kept (`--keep-exports-days`): an export can be made again while the
//! recordings of its dataset are there. Must not touch the rows of exports.
//!
//! A file is removed before its row, so that an interruption leaves no blob without a row, which later sweeps would take
//! for a recording. The next sweep continues where it ended.

use std::time::SystemTime;

use super::Sweeper;
use crate::{
    blocking::off_runtime,
    domain::{
        id::{BlobId, ExportId},
        time::Millis,
    },
    error::Result,
};

/// The files that are removed under one lock, for which uploads wait.
const AT_ONCE: usize = 64;

/// What was removed.
#[derive(Debug, Default, PartialEq, Eq)]
pub(super) struct Removed {
    pub(super) files: u64,
    pub(super) bytes: u64,
}

impl Sweeper {
    /// Removes the files of exports that were made more than `--keep-exports-days` before `now`. An export of which a file
    /// was stored since `old` stays for a later sweep, because an equal one that is being made may need it.
    ///
    /// # Errors
    /// When the database or the disk fails.
    pub(super) async fn forget_exports(&self, now: SystemTime, old: SystemTime) -> Result<Removed> {
        let mut removed = Removed::default();
        if self.maintenance.export_days == 0 {
            return Ok(removed);
        }
        let end = Millis::of(self.days_before(now, self.maintenance.export_days).await?);
        let mut after: Option<ExportId> = None;
        while let Some(export) = self.store.expired_export(end, after.as_ref()).await? {
            self.forget_export(&export, old, &mut removed).await?;
            after = Some(export);
        }
        Ok(removed)
    }

    async fn forget_export(&self, export: &ExportId, old: SystemTime, removed: &mut Removed) -> Result<()> {
        let files = self.store.kept_export_files(export).await?;
        for (_, blob) in &files {
            if self.placed_since(blob, old).await? {
                return Ok(());
            }
        }
        for some in files.chunks(AT_ONCE) {
            let Some(removing) = self.blobs.removing().await? else { return Ok(()) };
            let mut unneeded = Vec::new();
            for (_, blob) in some {
                if self.placed_since(blob, old).await? {
                    return Ok(());
                }
                if !self.store.names_blob_beside(blob, export).await? {
                    unneeded.push(blob.clone());
                }
            }
            let blobs = self.blobs.clone();
            let sizes = off_runtime("sweeping", move || {
                unneeded.iter().map(|blob| blobs.remove(blob, &removing)).collect::<Result<Vec<Option<u64>>>>()
            });
            for size in sizes.await?.into_iter().flatten() {
                removed.files += 1;
                removed.bytes += size;
            }
            if let Some((last, _)) = some.last() {
                self.store.forget_export_files(export, *last).await?;
            }
        }
        Ok(())
    }

    /// Whether a blob exists and was stored at this time or later.
    async fn placed_since(&self, blob: &BlobId, time: SystemTime) -> Result<bool> {
        let (blobs, id) = (self.blobs.clone(), blob.clone());
        Ok(off_runtime("sweeping", move || blobs.placed(&id)).await?.is_some_and(|placed| placed >= time))
    }
}
