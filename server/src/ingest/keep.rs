//! Recordings that the server made itself: the way of an upload, without a client.

use std::path::{Path, PathBuf};

use super::{Ingest, NewUpload, Started, off_runtime};
use crate::{
    blobs::{self, sync_folder},
    domain::{
        episode::{Episode, Outcome},
        id::{TaskId, UploadId},
    },
    error::{Error, Kind, Result},
};

/// A recording on this machine that is to become an episode.
#[derive(Debug, Clone)]
pub(crate) struct NewRecording {
    pub(crate) task_id: TaskId,
    pub(crate) file_name: String,
    pub(crate) outcome: Outcome,
    pub(crate) cohort: String,
    pub(crate) author: String,
}

impl Ingest {
    /// Stores a file of the data directory as an episode. The file stays; nobody may write it any more. When the
    /// task holds the content already, that episode is the answer, whatever its label: so a call that a crash has cut
    /// can be made again.
    ///
    /// # Errors
    /// Invalid when the task cannot use it; Exhausted when it is too large or the disk is full; Internal.
    pub(crate) async fn keep(&self, new: NewRecording, recording: &Path) -> Result<Episode> {
        let path = recording.to_owned();
        let (size_bytes, blake3) = off_runtime("reading a recording", move || {
            let fault = |error| Error::internal(format!("reading {}", path.display()), error);
            Ok((std::fs::metadata(&path).map_err(fault)?.len(), blobs::digest(&path)?))
        })
        .await?;
        let NewRecording { task_id, file_name, outcome, cohort, author } = new;
        let existing = || async { self.store.episode_of(&task_id, &blake3).await };
        let (task, digest) = (task_id.clone(), blake3.clone());
        let new = NewUpload { task_id: task, file_name, size_bytes, blake3: digest, outcome, cohort, author };
        let stored = match self.start(new).await {
            Ok(Started::Existing(episode)) => Ok(episode),
            Ok(Started::Open(upload)) => self.finish_file(&upload.id, recording, size_bytes).await,
            Err(error) => Err(error),
        };
        match stored {
            // It was stored before, and has another label since.
            Err(error) if error.kind() == Kind::Exists => existing().await?.ok_or(error),
            stored => stored,
        }
    }

    /// The file becomes the upload's part, by another name for the same bytes.
    async fn finish_file(&self, id: &UploadId, recording: &Path, size: u64) -> Result<Episode> {
        let (part, recording) = (self.part_path(id), recording.to_owned());
        off_runtime("linking a recording", move || link(&recording, &part)).await?;
        self.store.commit_upload(id, size).await?;
        self.finish(id).await.map(|inspected| inspected.episode)
    }

    /// Copies what is whole of a torn recording to `out`, in a child under the limits of an inspection, and says how
    /// many steps it may have.
    ///
    /// # Errors
    /// Invalid when there is nothing that can be read; Internal.
    pub(crate) async fn salvage(&self, torn: &Path, out: &Path) -> Result<u64> {
        self.inspector.salvage(torn, out).await
    }
}

fn link(recording: &Path, part: &PathBuf) -> Result<()> {
    let fault = |error| Error::internal(format!("linking {}", recording.display()), error);
    std::fs::File::open(recording).and_then(|file| file.sync_all()).map_err(fault)?;
    match std::fs::remove_file(part) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => return Err(fault(error)),
        Ok(()) | Err(_) => {}
    }
    std::fs::hard_link(recording, part).map_err(fault)?;
    part.parent().map_or(Ok(()), sync_folder)
}
