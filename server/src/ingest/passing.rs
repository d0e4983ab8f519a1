//! Recordings that are inspected and not stored: the same inspection as an upload's, and no file is left once their steps
//! have been used. After a crash their files lie in `tmp`, which the next start empties.

use std::{path::Path, sync::Arc};

use bytes::Bytes;
use futures::{Stream, StreamExt as _};
use gleaner_recording::{FrameCache, RecordingSummary, Report, TaskSpec};
use tempfile::TempDir;
use tokio::{fs::File, io::AsyncWriteExt as _, sync::OwnedSemaphorePermit};

use super::{Ingest, frames::open_frames, off_runtime, part::refused};
use crate::{
    domain::client::Client,
    error::{Error, Result},
};

/// The most such recordings at once: each may take as much disk as the largest upload, and then as much for its steps.
pub(super) const AT_ONCE: usize = 4;

/// After this many bytes the free space of the disk is checked again.
const POLL_INTERVAL: u64 = 4 << 20;

/// The field that declares the size.
const SIZE: &str = "open.size_bytes";

/// A client's description of a recording before it is sent.
#[derive(Debug, Clone, Default)]
pub(crate) struct Declared {
    /// For messages; may be empty.
    pub(crate) file_name: String,
    /// `None`: unknown beforehand.
    pub(crate) size_bytes: Option<u64>,
    /// What the recording states about itself, for an early refusal; the inspection decides.
    pub(crate) summary: Option<RecordingSummary>,
}

/// The permit for one such recording, to be held while any data of the recording is.
#[derive(Debug)]
pub(crate) struct InspectionPermit {
    /// The folder of its steps, which is removed first.
    pub(super) _folder: Option<TempDir>,
    pub(super) _place: OwnedSemaphorePermit,
}

/// The content of an inspected recording.
#[derive(Debug)]
pub(crate) struct Passing {
    /// Its steps, in a file that the permit holds.
    pub(crate) frames: FrameCache,
    /// The report of the inspection.
    pub(crate) report: Report,
    /// Held as long as the steps are.
    pub(crate) room: InspectionPermit,
}

impl Ingest {
    /// Inspects a recording like an upload, and removes it.
    ///
    /// # Errors
    /// Invalid when the task cannot use it, or its size differs from the declared one; Exhausted when it is too large,
    /// states more than is read here, or too many are being inspected; any error of the stream.
    pub(crate) async fn pass(
        &self,
        client: &Client,
        task: &TaskSpec,
        declared: Declared,
        chunks: impl Stream<Item = Result<Bytes>> + Unpin,
    ) -> Result<Passing> {
        let one = Arc::clone(&self.passing)
            .try_acquire_owned()
            .map_err(|_| Error::exhausted(format!("{AT_ONCE} recordings are being inspected already; retry later")))?;
        self.within_limits(SIZE, declared.size_bytes.unwrap_or(0))?;
        if let Some(summary) = &declared.summary {
            // Of an unknown size, the largest.
            let size_bytes = declared.size_bytes.unwrap_or(self.max_upload_bytes);
            self.content_fits("open.summary", (summary, size_bytes), task)?;
        }
        self.blobs.room_for(declared.size_bytes.unwrap_or(0)).await?;
        let tmp = self.data_dir.join("tmp");
        let folder = off_runtime("making room for a recording", move || {
            let made = tempfile::Builder::new().prefix("passing-").tempdir_in(tmp);
            made.map_err(|error| Error::internal("making room for a recording", error))
        })
        .await?;
        let recording = folder.path().join("recording.mcap");
        let size = self.receive(&recording, &declared, chunks).await?;
        let shown = if declared.file_name.is_empty() { "the recording" } else { &declared.file_name };
        let inspected = self.inspect(size, &recording, task, Some((client, shown))).await?;
        let frames = open_frames(inspected.frames_path(), task.clone()).await?;
        off_runtime("forgetting a recording", move || {
            drop(folder);
            Ok(())
        })
        .await?;
        let room = InspectionPermit { _folder: Some(inspected.folder), _place: one };
        Ok(Passing { frames, report: inspected.report, room })
    }

    /// Writes the stream to a temporary file; returns its size.
    async fn receive(
        &self,
        path: &Path,
        declared: &Declared,
        mut chunks: impl Stream<Item = Result<Bytes>> + Unpin,
    ) -> Result<u64> {
        let fault = |error| refused("writing", path, error);
        let mut file = File::create_new(path).await.map_err(fault)?;
        let (mut size, mut looked) = (0_u64, 0);
        while let Some(chunk) = chunks.next().await.transpose()? {
            size = size.saturating_add(chunk.len() as u64);
            self.within_limits(SIZE, size)?;
            if declared.size_bytes.is_some_and(|declared| size > declared) {
                break;
            }
            if size - looked >= POLL_INTERVAL {
                self.blobs.room_for(0).await?;
                looked = size;
            }
            file.write_all(&chunk).await.map_err(fault)?;
        }
        file.flush().await.map_err(fault)?;
        match declared.size_bytes {
            Some(declared) if size != declared => Err(Error::invalid(
                SIZE,
                format!(
                    "is {declared}, but {} bytes were received; send the whole file",
                    if size > declared { "more" } else { "less" }
                ),
            )),
            Some(_) | None => Ok(size),
        }
    }
}

#[cfg(test)]
mod tests;
