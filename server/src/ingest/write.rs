//! The bytes of an upload: a stream is appended to the part file, synced, and only then acknowledged.

use bytes::Bytes;
use futures::{Stream, StreamExt as _};
use tokio::time::{Duration, Instant, sleep_until};

use super::{Ingest, part::Part};
use crate::{
    domain::{episode::Upload, id::UploadId},
    error::{Error, Result},
};

/// Bytes are synced and acknowledged once there are this many, or once the oldest has waited this long. A client that
/// resumes sends the unacknowledged bytes again, including those on their way: a stream's window of 4 MiB and a
/// message. Together they stay under the promised 8 MiB.
const SYNC_BYTES: u64 = 2 << 20;
const SYNC_AFTER: Duration = Duration::from_millis(250);

/// Some bytes of a recording.
#[derive(Debug)]
pub(crate) struct Chunk {
    /// The upload; the first chunk of a stream must name it.
    pub(crate) upload_id: Option<UploadId>,
    /// Their offset in the recording.
    pub(crate) offset: u64,
    pub(crate) data: Bytes,
}

impl Ingest {
    /// Appends a stream of chunks. Bytes received before the stream ends or fails are kept and counted in the answer:
    /// the committed size.
    ///
    /// # Errors
    /// Invalid for an offset other than the end of the received bytes; NotFound; Unavailable when another stream of the
    /// same upload takes over; any error of the stream.
    pub(crate) async fn write(&self, chunks: impl Stream<Item = Result<Chunk>> + Send) -> Result<u64> {
        tokio::pin!(chunks);
        let Some(first) = chunks.next().await.transpose()? else {
            return Err(Error::invalid("upload_id", "the stream is empty: its first message must name the upload"));
        };
        let id = first
            .upload_id
            .clone()
            .ok_or_else(|| Error::invalid("upload_id", "the first message must name the upload"))?;
        self.store.upload(&id).await?;
        let claim = self.claims.take(&id).await;
        // The previous holder has left: only now is its row final.
        let upload = self.store.upload(&id).await?;
        let part = Part::open(self.part_path(&id), upload.committed, claim).await?;
        let mut writing = Writing { ingest: self, upload, part: Some(part), sync_at: Instant::now() };
        let ended = writing.run(first, chunks).await;
        // However the stream ended, received bytes are kept.
        let committed = writing.settle().await;
        ended.and(committed)
    }
}

/// One stream that writes an upload.
struct Writing<'a> {
    ingest: &'a Ingest,
    upload: Upload,
    /// `None` after an error of the disk: then the bytes since the last sync are not counted.
    part: Option<Part>,
    sync_at: Instant,
}

impl Writing<'_> {
    async fn run(&mut self, first: Chunk, mut chunks: impl Stream<Item = Result<Chunk>> + Unpin) -> Result<()> {
        self.append(first).await?;
        loop {
            let Some(part) = &self.part else { return Ok(()) };
            let unsynced = part.size > part.synced;
            let chunk = tokio::select! {
                () = part.leave() => {
                    return Err(Error::unavailable("another stream has taken over this upload"));
                }
                () = sleep_until(self.sync_at), if unsynced => {
                    self.settle().await?;
                    continue;
                }
                chunk = chunks.next() => chunk,
            };
            match chunk {
                Some(chunk) => self.append(chunk?).await?,
                None => return Ok(()),
            }
        }
    }

    async fn append(&mut self, chunk: Chunk) -> Result<()> {
        let Some(part) = &self.part else { return Ok(()) };
        let Chunk { upload_id, offset, data } = chunk;
        if upload_id.is_some_and(|id| id != self.upload.id) {
            return Err(Error::invalid("upload_id", "is another upload's; open another stream for it"));
        }
        if offset != part.size {
            return Err(Error::invalid(
                "offset",
                format!("is {offset}, expected {}; read GetUpload and resume from its committed size", part.size),
            ));
        }
        if part.size.saturating_add(data.len() as u64) > self.upload.size_bytes {
            return Err(Error::invalid(
                "data",
                format!(
                    "exceeds the declared size of {} bytes; start the upload again with the real size",
                    self.upload.size_bytes
                ),
            ));
        }
        if part.size - part.synced + data.len() as u64 > SYNC_BYTES {
            self.settle().await?;
        }
        if self.part.as_ref().is_some_and(|part| part.size == part.synced) {
            // Received bytes are kept; the client resumes once there is room.
            self.ingest.blobs.room_for(0).await?;
            self.sync_at = Instant::now() + SYNC_AFTER;
        }
        if let Some(part) = self.part.take() {
            self.part = Some(part.append(data).await?);
        }
        Ok(())
    }

    /// Syncs, then raises the committed size: only bytes on disk are acknowledged.
    async fn settle(&mut self) -> Result<u64> {
        let Some(part) = self.part.take() else { return Ok(self.upload.committed) };
        // After an error the bytes since the last sync are in doubt, and the next stream cuts them.
        self.part = Some(if part.size > part.synced { part.sync().await? } else { part });
        let synced = self.part.as_ref().map_or(self.upload.committed, |part| part.synced);
        if synced > self.upload.committed {
            self.ingest.store.commit_upload(&self.upload.id, synced).await?;
            self.upload.committed = synced;
        }
        Ok(synced)
    }
}
