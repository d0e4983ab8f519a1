//! The decoded steps of stored recordings, read from their frame caches. Must not depend on uploads.

use std::{
    ops::Range,
    path::{Path, PathBuf},
    sync::Arc,
};

use gleaner_inspector::most_written;
use gleaner_recording::{FrameCache, Numbers, RecordingError, TaskSpec};

use super::{Ingest, inspector::Inspected, off_runtime};
use crate::{
    blobs::Fetched,
    data_folder::{caches::note_use, frames_path},
    domain::{client::Client, id::BlobId},
    error::{Error, Kind, Result},
};

/// The steps of one stored recording. They hold no file; a cache that is missing or damaged when they are read is
/// rebuilt.
#[derive(Debug, Clone)]
pub struct Frames {
    ingest: Ingest,
    task: Arc<TaskSpec>,
    recording: BlobId,
    cache: FrameCache,
}

impl Ingest {
    /// The steps of a stored recording. A missing or damaged cache is rebuilt.
    ///
    /// # Errors
    /// Exhausted when the disk has no room for them; Internal when the recording can no longer be read.
    pub async fn frames(&self, task: &TaskSpec, recording: &BlobId) -> Result<Frames> {
        let path = frames_path(&self.data_dir, recording, task);
        let cache = match open_frames(path.clone(), task.clone()).await {
            Ok(cache) => cache,
            Err(error) => {
                tracing::info!(blob.id = %recording, %error, "rebuilding a frame cache");
                self.rebuild_frames(task, recording).await?;
                open_frames(path, task.clone()).await?
            }
        };
        Ok(Frames { ingest: self.clone(), task: Arc::new(task.clone()), recording: recording.clone(), cache })
    }

    async fn rebuild_frames(&self, task: &TaskSpec, recording: &BlobId) -> Result<()> {
        let inspect = async || {
            let blob = self.fetched(recording).await?;
            let size = std::fs::metadata(&blob).map_or(0, |file| file.len());
            self.inspect(size, &blob, task, None).await
        };
        let inspected = match inspect().await {
            Err(error) if error.kind() == Kind::Invalid && self.dropped_damaged_copy(recording).await => {
                inspect().await
            }
            inspected => inspected,
        };
        // It was accepted before, so the caller is not at fault.
        let inspected = inspected.map_err(|error| {
            if error.kind() != Kind::Invalid {
                return error;
            }
            Error::internal(format!("rebuilding the frames of {recording}"), error)
        })?;
        inspected.keep_frames(&self.blobs, &frames_path(&self.data_dir, recording, task)).await
    }

    /// The file of a stored recording.
    pub(super) async fn fetched(&self, recording: &BlobId) -> Result<Fetched> {
        let (blobs, id) = (self.blobs.clone(), recording.clone());
        off_runtime("fetching a recording", move || blobs.fetched(&id)).await
    }

    /// Whether a stored recording that could not be read was a damaged copy, which was removed, so that it can be fetched
    /// again.
    pub(super) async fn dropped_damaged_copy(&self, recording: &BlobId) -> bool {
        let (blobs, id) = (self.blobs.clone(), recording.clone());
        let dropped = off_runtime("checking a copy", move || blobs.drop_damaged_copy(&id)).await;
        dropped.unwrap_or_else(|error| {
            tracing::warn!(blob.id = %recording, %error, "the copy of a recording that cannot be read was not checked");
            false
        })
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
        let (blobs, most) = (self.blobs.clone(), most_written(self.inspector.memory_bytes, size_bytes));
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

impl Frames {
    /// Number of steps.
    pub fn steps(&self) -> usize {
        self.cache.steps()
    }

    /// The numbers of these steps.
    ///
    /// # Errors
    /// Internal when the recording can no longer be read, or does not have the steps.
    pub async fn numbers(&self, steps: Range<usize>) -> Result<Numbers> {
        self.read(move |cache| cache.numbers(steps.clone())).await
    }

    /// The images of these steps, one step after the other.
    ///
    /// # Errors
    /// As [`Frames::numbers`].
    pub async fn images(&self, steps: Range<usize>) -> Result<Vec<u8>> {
        self.read(move |cache| cache.frames(steps.clone())).await
    }

    /// Reads the cache, twice if it has to be rebuilt.
    async fn read<T: Send + 'static>(
        &self,
        read: impl Fn(&FrameCache) -> std::result::Result<T, RecordingError> + Clone + Send + 'static,
    ) -> Result<T> {
        let attempt = async || {
            let (cache, read) = (self.cache.clone(), read.clone());
            off_runtime("reading a frame cache", move || Ok(read(&cache))).await
        };
        let fault = |error| Error::internal("reading a frame cache", error);
        match attempt().await? {
            Err(error) if error.is_of_the_cache() => {
                tracing::info!(blob.id = %self.recording, %error, "rebuilding a frame cache");
                self.ingest.rebuild_frames(&self.task, &self.recording).await?;
                attempt().await?.map_err(fault)
            }
            read => read.map_err(fault),
        }
    }
}

/// Opens a frame cache and notes its use.
///
/// # Errors
/// Internal when it is missing or damaged.
pub(super) async fn open_frames(path: PathBuf, task: TaskSpec) -> Result<FrameCache> {
    off_runtime("opening a frame cache", move || {
        note_use(&path);
        FrameCache::open(&path, &task).map_err(|error| Error::internal(format!("opening {}", path.display()), error))
    })
    .await
}
