//! Decoded steps of recordings: files of the cache, which an inspection writes. Must not depend on uploads.

use std::path::{Path, PathBuf};

use gleaner_recording::{Episode as Frames, TaskSpec};

use super::{Ingest, inspector::Inspected, off_runtime};
use crate::{
    data_folder::{caches::note_use, frames_path},
    domain::{client::Client, id::BlobId},
    error::{Error, Kind, Result},
};

impl Ingest {
    /// The steps of a stored recording, mapped rather than read. A missing or damaged cache is rebuilt.
    ///
    /// # Errors
    /// Exhausted when the disk has no room for them; Internal when the recording can no longer be read.
    pub async fn frames(&self, task: &TaskSpec, recording: &BlobId) -> Result<Frames> {
        let path = frames_path(&self.data_dir, recording, task);
        match open_frames(path.clone()).await {
            Ok(frames) => return Ok(frames),
            Err(error) => tracing::info!(blob.id = %recording, %error, "rebuilding a frame cache"),
        }
        let blob = self.blobs.path(recording);
        let size = std::fs::metadata(&blob).map_or(0, |file| file.len());
        let inspected = self.inspect(size, &blob, task, None).await;
        // It was accepted before, so the caller is not at fault.
        let inspected = inspected.map_err(|error| {
            if error.kind() != Kind::Invalid {
                return error;
            }
            Error::internal(format!("rebuilding the frames of {recording}"), error)
        })?;
        inspected.keep_frames(&self.blobs, &path).await?;
        open_frames(path).await
    }

    /// Inspects a recording of this size with room for its decoded steps, which take about as much. If the disk fills up
    /// nevertheless, other decoded steps make room for the most that an inspection may write, and it is repeated once.
    /// `new`: the client of a recording that is not stored yet, and its name of the file.
    ///
    /// # Errors
    /// Exhausted when the disk has no room; those of the inspection.
    pub(super) async fn inspect(
        &self,
        size_bytes: u64,
        recording: &Path,
        task: &TaskSpec,
        new: Option<(&Client, &str)>,
    ) -> Result<Inspected> {
        self.blobs.room_for(size_bytes).await?;
        let error = match self.inspect_once(recording, task, new).await {
            Err(error) if error.kind() == Kind::Exhausted => error,
            inspected => return inspected,
        };
        let (blobs, most) = (self.blobs.clone(), self.inspector.memory_bytes);
        match off_runtime("making room for decoded steps", move || blobs.caches().evict(most)).await? {
            0 => Err(error),
            _ => self.inspect_once(recording, task, new).await,
        }
    }

    async fn inspect_once(&self, recording: &Path, task: &TaskSpec, new: Option<(&Client, &str)>) -> Result<Inspected> {
        let inspected = match new {
            Some((client, shown)) => self.inspector.inspect(client, recording, task, shown).await,
            None => self.inspector.inspect_admitted(recording, task).await,
        };
        inspected.map_err(|error| self.blobs.blame(error))
    }
}

/// Opens a file of decoded steps and notes its use.
///
/// # Errors
/// Internal when it is missing or damaged.
pub(super) async fn open_frames(path: PathBuf) -> Result<Frames> {
    off_runtime("opening a frame cache", move || {
        note_use(&path);
        Frames::open(&path).map_err(|error| Error::internal(format!("opening {}", path.display()), error))
    })
    .await
}
