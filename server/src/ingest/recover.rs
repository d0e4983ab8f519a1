//! Recovery of uploads after a crash, before new ones are accepted; and the periodic removal of abandoned ones.

use std::{
    collections::HashMap,
    fs,
    path::Path,
    sync::Arc,
    time::{Duration, SystemTime},
};

use super::{Ingest, off_runtime, part, part_path};
use crate::{
    blobs::{Blobs, sync_folder},
    domain::{episode::Upload, time::Millis},
    error::{Error, Kind, Result},
    lock::StandbyLock,
    store::Store,
};

/// Creates the folders; empties `tmp`, and removes drafts from `cache` and part files without a row; cuts parts that are
/// longer than their acknowledged bytes, and removes uploads whose parts are shorter, which happens on a faulty disk
/// only. Where workers of an earlier server, or standbys of this one, still run, `tmp` and the drafts are left to the sweep,
/// which knows their age.
pub(super) async fn recover(data_dir: &Path, store: &Store, blobs: &Blobs) -> Result<()> {
    let uploads = store.uploads().await?;
    let working = store.running_attempts().await?.iter().any(|left| !left.placement.is_of_children());
    let (data_dir, blobs) = (data_dir.to_owned(), blobs.clone());
    let torn = off_runtime("recovering uploads", move || {
        let fault = |error| Error::internal(format!("recovering uploads in {}", data_dir.display()), error);
        for folder in ["uploads", "cache", "tmp"] {
            fs::create_dir_all(data_dir.join(folder)).map_err(fault)?;
        }
        // Without the entry in its parent, a folder is lost with everything acknowledged in it.
        sync_folder(&data_dir)?;
        let alone = StandbyLock::keep_out(&data_dir).map_err(fault)?;
        if !working && alone.is_some() {
            empty(&data_dir.join("tmp"), |_| true).map_err(fault)?;
            // Left by killed workers.
            let half = |path: &Path| path.extension().is_some_and(|extension| extension == "partial");
            empty(&data_dir.join("cache"), half).map_err(fault)?;
        }
        settle_parts(&data_dir, uploads, &blobs).map_err(fault)
    })
    .await?;
    for upload in torn {
        match store.delete_upload(&upload.id).await {
            // A disk that accepts no writes does not stop the start: the next start retries.
            Err(error) if matches!(error.kind(), Kind::Exhausted | Kind::Unavailable) => {
                tracing::error!(upload.id = %upload.id, %error, "a torn upload could not be removed");
            }
            deleted => deleted?,
        }
    }
    Ok(())
}

impl Ingest {
    /// How long an upload is kept after its last byte.
    pub(crate) fn keep_for(&self) -> Duration {
        self.keep_for
    }

    /// Removes the uploads whose last byte is older than the limit at `now`, and returns their number.
    ///
    /// # Errors
    /// When the database or the disk fails.
    pub(crate) async fn forget_abandoned(&self, now: SystemTime) -> Result<u64> {
        let before = now.checked_sub(self.keep_for).unwrap_or(SystemTime::UNIX_EPOCH);
        let (old, data_dir) = (self.store.uploads_before(Millis::of(before)).await?, Arc::clone(&self.data_dir));
        let abandoned = off_runtime("looking for abandoned uploads", move || {
            let quiet = |upload: &Upload| {
                let written = fs::metadata(part_path(&data_dir, &upload.id)).and_then(|part| part.modified());
                written.map_or(true, |at| at < before)
            };
            Ok(old.into_iter().filter(quiet).collect::<Vec<_>>())
        })
        .await?;
        let mut forgotten = 0;
        for upload in abandoned.iter().filter(|upload| self.claims.is_idle(&upload.id)) {
            tracing::info!(upload.id = %upload.id, upload.committed = upload.committed, "an abandoned upload was removed");
            self.discard(&upload.id).await?;
            forgotten += 1;
        }
        Ok(forgotten)
    }
}

/// Removes the `unwanted` entries of a folder.
fn empty(folder: &Path, unwanted: impl Fn(&Path) -> bool) -> std::io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        if !unwanted(&entry.path()) {
            continue;
        }
        match entry.file_type()?.is_dir() {
            true => fs::remove_dir_all(entry.path())?,
            false => fs::remove_file(entry.path())?,
        }
    }
    Ok(())
}

/// Returns the uploads whose bytes are missing.
fn settle_parts(data_dir: &Path, uploads: Vec<Upload>, blobs: &Blobs) -> std::io::Result<Vec<Upload>> {
    let mut open: HashMap<_, _> = uploads.into_iter().map(|upload| (part_path(data_dir, &upload.id), upload)).collect();
    // Listed beforehand: cutting a part may put another file in its place.
    let parts: Vec<_> = fs::read_dir(data_dir.join("uploads"))?.collect::<std::io::Result<_>>()?;
    for path in parts.into_iter().map(|entry| entry.path()) {
        let Some(upload) = open.get(&path) else {
            fs::remove_file(&path)?;
            continue;
        };
        let size = fs::metadata(&path)?.len();
        if size > upload.committed {
            part::cut(&path, upload.committed)?;
        }
        if size >= upload.committed {
            open.remove(&path);
        }
    }
    // A finish interrupted between the move and the row: the recording is in its place, the row remains.
    let mut torn = HashMap::new();
    for (path, upload) in open {
        let complete = upload.committed == upload.size_bytes;
        if !(complete && blobs.size(&upload.blake3).map_err(std::io::Error::other)?.is_some()) {
            torn.insert(path, upload);
        }
    }
    let open = torn;
    for (path, upload) in &open {
        tracing::error!(
            upload.id = %upload.id, upload.committed = upload.committed, file.path = %path.display(),
            "acknowledged bytes of an upload were lost by the disk; the upload must start again"
        );
        if path.exists() {
            fs::remove_file(path)?;
        }
    }
    Ok(open.into_values().collect())
}
