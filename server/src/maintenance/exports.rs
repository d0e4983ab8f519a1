//! Removes the files of exports that are no longer kept (`--keep-exports-days`). They can be made again: the same dataset
//! gives the same files. Must not touch the rows of exports.

use std::time::SystemTime;

use super::{Sweeper, sweep::off_runtime};
use crate::{domain::time::Millis, error::Result};

/// The files that are forgotten at once. If the process ends before they are removed, the next sweep moves those without a
/// row to the trash, because it moves as many whatever their share of all blobs.
const AT_ONCE: u32 = 8;

impl Sweeper {
    /// Forgets and removes the files of exports that were made more than `--keep-exports-days` before `now`; returns the
    /// number of removed files and their bytes. A file that was stored again since `old` stays, because an equal export that
    /// is being made may need it.
    ///
    /// # Errors
    /// When the database or the disk fails.
    pub(super) async fn forget_exports(&self, now: SystemTime, old: SystemTime) -> Result<(u64, u64)> {
        let (mut files, mut bytes) = (0, 0);
        if self.maintenance.export_days == 0 {
            return Ok((files, bytes));
        }
        let end = Millis::of(self.days_before(now, self.maintenance.export_days).await?);
        // Not while the data folder is copied: blobs would stay without a row.
        while let Some(removing) = self.blobs.removing().await? {
            let forgotten = self.store.forget_export_files(end, AT_ONCE).await?;
            if forgotten.is_empty() {
                break;
            }
            let mut unneeded = Vec::new();
            for blob in forgotten {
                if self.placed_before(&blob, old).await? && !self.store.names_blob(&blob).await? {
                    unneeded.push(blob);
                }
            }
            let blobs = self.blobs.clone();
            let removed = off_runtime(move || {
                unneeded.iter().map(|blob| blobs.remove(blob, &removing)).collect::<Result<Vec<Option<u64>>>>()
            });
            for size in removed.await?.into_iter().flatten() {
                (files, bytes) = (files + 1, bytes + size);
            }
        }
        Ok((files, bytes))
    }
}
