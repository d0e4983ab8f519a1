//! Blobs of running workers, which have no credentials of a bucket: where a worker reads one, and how it stores one.

use super::Jobs;
use crate::{
    blobs::Blobs,
    domain::{Secret, attempt::Attempt, id::BlobId},
    error::{Error, Kind, Result},
};

/// Where a worker reads a blob.
#[derive(Debug)]
pub(crate) struct Located {
    pub(crate) size_bytes: u64,
    /// A URL of the bucket. `None`: the file in the data folder, which is there if it was to be fetched.
    pub(crate) url: Option<Secret>,
}

impl Jobs {
    /// The size of a blob, and where it can be read: at a URL if `accept_url`, or else, if `fetch`, in the data folder. Not
    /// limited to the inputs of a job, because workers share the data folder.
    ///
    /// # Errors
    /// NotFound when it does not exist; Unavailable when the store fails; Precondition when its object is damaged or cannot
    /// be read.
    pub(crate) async fn locate_blob(&self, blob: &BlobId, accept_url: bool, fetch: bool) -> Result<Located> {
        let wanted = accept_url || fetch;
        let size =
            self.with_blob(blob, move |blobs, id| if wanted { blobs.make_copy_room(id) } else { blobs.size(id) });
        let size_bytes = size.await?.ok_or_else(|| Error::not_found("blob", blob))?;
        let lifetime = self.0.config.blob_store.url_lifetime().filter(|_| accept_url);
        let url = self.0.blobs.signed_url(blob, lifetime).await;
        if fetch && url.is_none() {
            self.with_blob(blob, Blobs::keep_copy).await?;
        }
        Ok(Located { size_bytes, url })
    }

    /// Stores the file that the worker of an attempt has handed over as a blob. The transfer of a large one takes long, while
    /// the worker waits.
    ///
    /// # Errors
    /// NotFound when there is neither a file nor the blob; Precondition when the file is not this blob or cannot be stored;
    /// Unavailable when the store fails; Exhausted when the disk is full.
    pub(crate) async fn store_blob(&self, attempt: &Attempt, blob: &BlobId) -> Result<()> {
        self.0.leases.renew_during(attempt, self.with_blob(blob, Blobs::take)).await
    }

    /// Uses a blob off the runtime. An internal error is for the worker, whose job fails by it: its message names the file or
    /// object.
    async fn with_blob<T: Send + 'static>(
        &self,
        blob: &BlobId,
        work: impl FnOnce(&Blobs, &BlobId) -> Result<T> + Send + 'static,
    ) -> Result<T> {
        let (blobs, id) = (self.0.blobs.clone(), blob.clone());
        let done = tokio::task::spawn_blocking(move || work(&blobs, &id)).await;
        done.map_err(|error| Error::internal("using a blob for a worker", error))?.map_err(|error| {
            if error.kind() != Kind::Internal {
                return error;
            }
            tracing::error!(blob.id = %blob, %error, "a worker's blob cannot be used");
            Error::precondition(error.to_string())
        })
    }
}

#[cfg(test)]
mod tests;
