//! Copies of stored recordings with the scores of a run beside their messages. A limited child writes them, like an
//! inspection, and no file remains once they are read.

use bytes::Bytes;
use futures::{FutureExt as _, StreamExt as _, stream::BoxStream};
use gleaner_recording::{Kept, TaskSpec};

use super::{Ingest, off_runtime};
use crate::{
    blobs::stream_file,
    domain::{client::Client, episode::Episode},
    error::{Error, Kind, Result},
};

/// The most such copies at once, of which one client has all but one at most: each takes as much disk as its recording
/// until it is read.
pub(super) const AT_ONCE: usize = 4;

/// A copy, which takes disk until its bytes are dropped.
pub(crate) struct ScoredCopy {
    /// Number of bytes.
    pub(crate) size_bytes: u64,
    /// The file.
    pub(crate) bytes: BoxStream<'static, Result<Bytes>>,
}

impl Ingest {
    /// Copies the recording of an episode with these scores.
    ///
    /// # Errors
    /// Exhausted when too many copies are read, by all clients or by this one, or the disk has no room; Internal when the recording can no longer be read.
    pub(crate) async fn scored_copy(
        &self,
        client: &Client,
        task: &TaskSpec,
        episode: &Episode,
        kept: Kept,
    ) -> Result<ScoredCopy> {
        let one = self.scored.take(client).now_or_never().unwrap_or_else(|| {
            Err(Error::exhausted(format!(
                "{AT_ONCE} scored episodes are being read already, or {} by this client; retry later",
                AT_ONCE - 1
            )))
        })?;
        self.blobs.room_for(episode.size_bytes).await?;
        let extract = async |kept: Kept| {
            let recording = self.fetched(&episode.recording).await?;
            self.inspector.extract(client, &recording, task, kept).await
        };
        let copied = match extract(kept.clone()).await {
            Err(error) if error.kind() == Kind::Internal && self.dropped_damaged_copy(&episode.recording).await => {
                extract(kept).await?
            }
            copied => copied?,
        };
        let path = copied.path();
        let fault = |error| Error::internal("reading a scored episode", error);
        let size_bytes = tokio::fs::metadata(&path).await.map_err(fault)?.len();
        let bytes = stream_file(path).await?;
        // The open file outlives its name.
        off_runtime("forgetting a scored episode", move || {
            drop(copied);
            Ok(())
        })
        .await?;
        let bytes = bytes.map(move |piece| {
            let _held = &one;
            piece
        });
        Ok(ScoredCopy { size_bytes, bytes: bytes.boxed() })
    }
}

#[cfg(test)]
mod tests;
