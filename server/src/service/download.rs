//! A file for a caller: its bytes, or a URL of the bucket for a caller that accepts one.

use bytes::Bytes;
use futures::{StreamExt as _, TryStreamExt as _, stream};

use super::{
    Services,
    answer::{Responses, responses},
};
use crate::{domain::id::BlobId, error::Result};

impl Services {
    /// The messages of a download: many with bytes and no URL, or a single one with a URL and no bytes.
    ///
    /// # Errors
    /// Internal when the blob is missing or cannot be read; Unavailable when the store fails.
    pub(super) async fn download<T: Send + 'static>(
        &self,
        blob: &BlobId,
        accept_url: bool,
        message: impl Fn(Bytes, String) -> T + Send + 'static,
    ) -> Result<Responses<T>> {
        let lifetime = self.config.blob_store.url_lifetime().filter(|_| accept_url);
        if let Some(url) = self.blobs.signed_url(blob, lifetime).await {
            let only = message(Bytes::new(), url.reveal().to_owned());
            return Ok(stream::iter([Ok(only)]).boxed());
        }
        let bytes = self.blobs.stream(blob).await?;
        Ok(responses(bytes.map_ok(move |data| message(data, String::new()))))
    }
}
