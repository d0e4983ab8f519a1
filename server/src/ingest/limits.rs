//! Checks of a recording's declared size, before its first byte: the limit on recordings, that on files, and the room of
//! the disk beside the uploads that are on their way.

use super::Ingest;
use crate::{
    error::{Error, Result},
    file_limit::largest_file,
};

impl Ingest {
    /// Whether a recording of this size may be stored here at all.
    ///
    /// # Errors
    /// Exhausted names the limit and its value.
    pub(super) fn within_limits(&self, field: &str, size_bytes: u64) -> Result<()> {
        let most = self.max_upload_bytes;
        if size_bytes > most {
            return Err(Error::exhausted(format!(
                "{field}: {size_bytes} is above this server's limit of {most} bytes a recording (--max-upload-bytes): \
                 split the recording, or raise the limit at the server"
            )));
        }
        match largest_file().filter(|most| size_bytes > *most) {
            Some(most) => Err(Error::exhausted(format!(
                "{field}: {size_bytes} is above the file size limit of the server's process, {most} bytes: raise it there \
                 (`ulimit -f`, LimitFSIZE= of its service), then push the file again"
            ))),
            None => Ok(()),
        }
    }

    /// Makes room for a recording of this size beside the bytes that active uploads still have to send.
    ///
    /// # Errors
    /// Exhausted when too little would stay free.
    pub(super) async fn make_room_for_upload(&self, size_bytes: u64) -> Result<()> {
        let uploads = self.store.uploads().await?;
        let active = uploads.iter().filter(|upload| !self.claims.is_idle(&upload.id));
        let coming: u64 = active.map(|upload| upload.size_bytes - upload.committed.min(upload.size_bytes)).sum();
        self.blobs.room_for(size_bytes.saturating_add(coming)).await.map_err(|error| match coming {
            0 => error,
            _ => Error::exhausted(format!("{}; uploads in progress are to take {coming} of them", error.message())),
        })
    }
}
