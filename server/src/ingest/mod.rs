//! Uploads in: from bytes to an inspected episode, or nothing.
//!
//! Bytes gather in a part file. A finished upload is inspected in a child process with limits, because reading
//! hostile bytes can abort a process. Only what passed becomes a blob and a row. Knows no wire type.

mod claim;
#[cfg(test)]
mod contract;
mod describe;
mod existing;
mod fair_queue;
mod inspector;
mod keep;
mod part;
mod passing;
mod program;
mod recover;
mod slots;
#[cfg(test)]
pub(crate) mod testing;
#[cfg(test)]
mod tests;
mod upload;
mod write;

use std::{
    path::{Path, PathBuf},
    sync::Arc,
    time::Duration,
};

use gleaner_recording::{Episode as Frames, TaskSpec};
use tokio::sync::Semaphore;

pub use self::program::can_inspect;
use self::{claim::Claims, inspector::Inspector};
pub(crate) use self::{
    keep::NewRecording,
    passing::{Declared, Passing, Room},
    upload::{NewUpload, Started},
    write::Chunk,
};
use crate::{
    blobs::{Blobs, sync_folder},
    config::ServeConfig,
    domain::id::{BlobId, UploadId},
    error::{Error, Kind, Result},
    store::Store,
};

/// Handle to the uploads of one data directory; clones share it.
#[derive(Debug, Clone)]
pub struct Ingest {
    store: Store,
    blobs: Blobs,
    claims: Claims,
    inspector: Arc<Inspector>,
    /// One for each recording that is looked at and not kept.
    passing: Arc<Semaphore>,
    data_dir: Arc<Path>,
    max_upload_bytes: u64,
    /// `None`: any number.
    max_open_uploads: Option<u64>,
    /// How long an upload that nobody goes on with is kept.
    keep_for: Duration,
}

impl Ingest {
    /// Opens the uploads and puts right what a crash left: see `recover`.
    ///
    /// # Errors
    /// Internal when the data directory or the database cannot be used.
    pub async fn open(config: &Arc<ServeConfig>, store: Store, blobs: Blobs) -> Result<Self> {
        let data_dir: Arc<Path> = config.data_dir.as_path().into();
        recover::recover(&data_dir, &store, &blobs).await?;
        Ok(Self {
            store,
            blobs,
            claims: Claims::default(),
            inspector: Arc::new(Inspector::new(&config.data_dir, &config.limits)?),
            passing: Arc::new(Semaphore::new(passing::AT_ONCE)),
            data_dir,
            max_upload_bytes: config.limits.max_upload_bytes,
            max_open_uploads: config.uploads.max_open_per_client(),
            keep_for: config.uploads.keep_for(),
        })
    }

    /// The steps of a stored recording, mapped rather than read. A cache that is missing or damaged is rebuilt.
    ///
    /// # Errors
    /// Internal when the recording does not read any more.
    pub async fn frames(&self, task: &TaskSpec, recording: &BlobId) -> Result<Frames> {
        let path = frames_path(&self.data_dir, recording, task);
        match open_frames(path.clone()).await {
            Ok(frames) => return Ok(frames),
            Err(error) => tracing::info!(blob.id = %recording, %error, "rebuilding a frame cache"),
        }
        let inspected = self.inspector.inspect_admitted(&self.blobs.path(recording), task).await;
        // It was read before, so it is not the caller who is wrong now.
        let inspected = inspected.map_err(|error| {
            if error.kind() != Kind::Invalid {
                return error;
            }
            Error::internal(format!("rebuilding the frames of {recording}"), error)
        })?;
        inspected.keep_frames(&path).await?;
        open_frames(path).await
    }

    /// Where recordings are kept.
    pub(crate) fn blobs(&self) -> &Blobs {
        &self.blobs
    }

    fn part_path(&self, upload: &UploadId) -> PathBuf {
        part_path(&self.data_dir, upload)
    }
}

/// Where the decoded steps of a recording are kept, read by this task. Derived: it can always be rebuilt.
pub fn frames_path(data_dir: &Path, recording: &BlobId, spec: &TaskSpec) -> PathBuf {
    // A spec that cannot be written as JSON does not exist: it came from JSON.
    let spec = serde_json::to_vec(spec).unwrap_or_default();
    let spec = blake3::hash(&spec).to_hex();
    data_dir.join("cache").join(format!("{recording}-{}.frames", spec.get(..16).unwrap_or_default()))
}

/// Where the bytes of an open upload gather.
pub(crate) fn part_path(data_dir: &Path, upload: &UploadId) -> PathBuf {
    data_dir.join("uploads").join(format!("{upload}.part"))
}

async fn open_frames(path: PathBuf) -> Result<Frames> {
    off_runtime("opening a frame cache", move || {
        Frames::open(&path).map_err(|error| Error::internal(format!("opening {}", path.display()), error))
    })
    .await
}

/// Runs what blocks away from the runtime's threads.
async fn off_runtime<T: Send + 'static>(
    doing: &'static str,
    work: impl FnOnce() -> Result<T> + Send + 'static,
) -> Result<T> {
    tokio::task::spawn_blocking(work).await.map_err(|error| Error::internal(doing, error))?
}
