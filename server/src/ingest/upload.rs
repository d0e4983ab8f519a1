//! The life of an upload without its bytes: start, status, finish.

use gleaner_recording::InspectionEstimate;
use tracing::Instrument as _;

use super::{Ingest, existing::same_label, off_runtime, part};
use crate::{
    blobs,
    data_folder::frames_path,
    domain::{
        client::Client,
        episode::{Episode, InspectedEpisode, NewUpload, Upload},
        id::UploadId,
    },
    error::{Error, Kind, Result},
};

/// The answer to the start of an upload.
#[derive(Debug)]
pub(crate) enum Started {
    /// Continue writing from its committed size.
    Open(Upload),
    /// The task holds this content under this label already.
    Existing(Episode),
}

impl Ingest {
    /// Opens an upload, or resumes an inactive one of the same content.
    ///
    /// # Errors
    /// Exists when the task holds the content under another label; Exhausted above a limit on its size or on what its
    /// summary states, when the disk lacks room beside the active uploads, or when the client has too many open uploads.
    pub(crate) async fn start(&self, new: NewUpload) -> Result<Started> {
        let estimate = self.within_declared_limits(&new).await?.unwrap_or_default();
        self.store.verify()?;
        let upload = new.open();
        if let Some(existing) = self.stored(&upload).await? {
            let existing = same_label(existing, upload.outcome, &upload.cohort)?;
            self.discard_idle(&upload).await?;
            return Ok(Started::Existing(existing));
        }
        self.blobs.room_for(0).await?;
        for open in self.store.uploads_of(&upload.task_id, &upload.blake3).await? {
            if open.is_like(&upload) && self.claims.offer(&open.id).await {
                match self.store.upload(&open.id).await {
                    Ok(open) => return Ok(Started::Open(open)),
                    // It ended while this call waited for it.
                    Err(error) if error.kind() == Kind::NotFound => self.claims.forget(&open.id),
                    Err(error) => return Err(error),
                }
            }
        }
        if let Some(existing) = self.stored(&upload).await? {
            return same_label(existing, upload.outcome, &upload.cohort).map(Started::Existing);
        }
        self.make_room_for_upload(upload.size_bytes.saturating_add(estimate.least_decoded_bytes)).await?;
        let path = self.part_path(&upload.id);
        off_runtime("making a part file", move || part::create(&path)).await?;
        crate::fail_point::pass("upload.part_made");
        self.claims.promise(&upload.id);
        if !self.store.insert_upload(&upload, self.most_open(&upload.client)).await? {
            self.discard(&upload.id).await?;
            return Err(self.too_many_open());
        }
        crate::fail_point::pass("upload.row_made");
        Ok(Started::Open(upload))
    }

    /// Checks an upload as [`Ingest::start`] does, and opens none. Returns the existing episode of its content, and what an
    /// inspection takes by the recording's summary.
    ///
    /// # Errors
    /// As for [`Ingest::start`], apart from the room of the disk that caches would leave and the number of open uploads.
    pub(crate) async fn check(&self, new: NewUpload) -> Result<(Option<Episode>, Option<InspectionEstimate>)> {
        let estimate = self.within_declared_limits(&new).await?;
        let upload = new.open();
        match self.stored(&upload).await? {
            Some(existing) => Ok((Some(same_label(existing, upload.outcome, &upload.cohort)?), estimate)),
            None => Ok((None, estimate)),
        }
    }

    /// The most uploads that the client may have open. Recordings of sessions have no limit: their robots were accepted
    /// already.
    fn most_open(&self, client: &Client) -> Option<u64> {
        match client {
            Client::Token(_) | Client::Address(_) => self.max_open_uploads,
            Client::Server => None,
        }
    }

    fn too_many_open(&self) -> Error {
        let (most, days) = (self.max_open_uploads.unwrap_or_default(), self.keep_for.as_secs() / (24 * 60 * 60));
        Error::exhausted(format!(
            "{most} uploads of this caller are open, the most that the server allows (--max-open-uploads-per-caller): \
             finish them by pushing the same files again, or wait until the server removes them {days} days after \
             their last byte (--keep-uploads-days)"
        ))
    }

    /// An open upload with its committed size.
    ///
    /// # Errors
    /// NotFound.
    pub(crate) async fn status(&self, id: &UploadId) -> Result<Upload> {
        self.store.upload(id).await
    }

    /// Checks size and digest, inspects the recording, and makes the episode visible. When the same content has become
    /// visible meanwhile, that episode is the answer.
    ///
    /// # Errors
    /// Precondition while bytes are missing; Invalid when the content is not as declared or the task cannot use it
    /// (then it is removed); Exists when the same content became visible under another label; NotFound.
    pub(crate) async fn finish(&self, id: &UploadId) -> Result<InspectedEpisode> {
        // A task of its own: minutes of inspection continue without the caller, which finds the episode later.
        let (ingest, id) = (self.clone(), id.clone());
        let finishing = async move { ingest.finish_here(&id).await };
        let finished = tokio::spawn(finishing.in_current_span()).await;
        finished.map_err(|error| Error::internal("finishing an upload", error))?
    }

    /// As [`Ingest::finish`], while its caller waits.
    pub(super) async fn finish_here(&self, id: &UploadId) -> Result<InspectedEpisode> {
        self.store.upload(id).await?;
        let _claim = self.claims.take(id).await;
        let upload = self.store.upload(id).await?;
        if upload.committed < upload.size_bytes {
            return Err(Error::precondition(format!(
                "{} of {} bytes were received; write the rest, then finish",
                upload.committed, upload.size_bytes
            )));
        }
        if let Some(existing) = self.stored(&upload).await? {
            self.discard(id).await?;
            return self.settle_on(existing, &upload).await;
        }
        self.blobs.room_for(0).await?;
        match self.admit(&upload).await {
            Err(error) if error.kind() == Kind::Invalid => {
                self.discard(id).await?;
                Err(error)
            }
            result => result,
        }
    }

    /// From a complete part file to a visible episode.
    async fn admit(&self, upload: &Upload) -> Result<InspectedEpisode> {
        let (part, blobs) = (self.part_path(&upload.id), self.blobs.clone());
        let declared = upload.blake3.clone();
        let recording = off_runtime("checking a digest", move || {
            // A crash between the move and the row leaves the recording in its place already.
            let stored = !part.exists();
            let recording = if stored { blobs.fetched(&declared)? } else { part.into() };
            if blobs::digest(&recording)? == declared {
                return Ok(recording);
            }
            // Of a recording in its place, the copy may be damaged. What is fetched has the digest.
            if stored && blobs.drop_damaged_copy(&declared)? {
                return blobs.fetched(&declared);
            }
            Err(Error::invalid("blake3", "the content does not match the declared digest; push the file again"))
        })
        .await?;
        crate::fail_point::pass("upload.digest_checked");
        let task = self.store.task_by_id(&upload.task_id).await?;
        let new = Some((&upload.client, upload.file_name.as_str()));
        let inspected = self.inspect(upload.size_bytes, &recording, &task.spec, new).await?;
        crate::fail_point::pass("upload.inspected");
        inspected.keep_frames(&self.blobs, &frames_path(&self.data_dir, &upload.blake3, &task.spec)).await?;
        crate::fail_point::pass("upload.frames_kept");
        let (blobs, id) = (self.blobs.clone(), upload.blake3.clone());
        let recording =
            off_runtime("sending a recording", move || blobs.send(&id, &recording).map(|()| recording)).await?;
        crate::fail_point::pass("upload.blob_sent");
        // From here until its row is committed, no sweep removes the blob.
        let naming = self.blobs.naming().await;
        let (blobs, id) = (self.blobs.clone(), upload.blake3.clone());
        let place = move || blobs.place_sent(&id, &recording, &naming).map(|()| naming);
        let naming = off_runtime("storing a recording", place).await?;
        crate::fail_point::pass("upload.blob_placed");

        let episode = upload.become_episode(&inspected.report);
        let inspected = InspectedEpisode { episode, report: inspected.report };
        self.describe(&task, &inspected, &upload.author).await?;
        let kept = self.store.finish_upload(upload, &inspected).await?;
        drop(naming);
        self.claims.forget(&upload.id);
        tracing::info!(episode.id = %kept.id, episode.steps = kept.steps, episode.bytes = kept.size_bytes, "episode stored");
        if kept.id == inspected.episode.id {
            return Ok(inspected);
        }
        // The row is an earlier one's: of a concurrent push, or of an episode whose recording was lost.
        let (blobs, id, recording) = (self.blobs.clone(), inspected.episode.id, kept.recording.clone());
        let settled = self.settle_on(kept, upload).await;
        if let Ok(settled) = &settled {
            self.describe(&task, settled, &upload.author).await?;
        }
        // Also of a refused label: a rebuild would take it for the newer one.
        off_runtime("removing a sidecar", move || blobs.forget_description(&recording, id.as_str())).await?;
        settled
    }

    /// Removes the inactive uploads of this content: its episode exists.
    async fn discard_idle(&self, upload: &Upload) -> Result<()> {
        for open in self.store.uploads_of(&upload.task_id, &upload.blake3).await? {
            if self.claims.is_idle(&open.id) {
                self.discard(&open.id).await?;
            }
        }
        Ok(())
    }

    /// Removes an upload.
    pub(super) async fn discard(&self, id: &UploadId) -> Result<()> {
        self.store.delete_upload(id).await?;
        crate::fail_point::pass("upload.row_removed");
        self.claims.forget(id);
        let path = self.part_path(id);
        off_runtime("removing a part file", move || match std::fs::remove_file(&path) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                Err(Error::internal(format!("removing {}", path.display()), error))
            }
            Ok(()) | Err(_) => {
                crate::fail_point::pass("upload.part_removed");
                Ok(())
            }
        })
        .await
    }
}

#[cfg(test)]
mod tests;
