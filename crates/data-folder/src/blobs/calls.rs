//! The calls by which a process without credentials of a bucket uses its blobs: a trait, so that this crate names no
//! protocol. Depends on no other module of the blobs.

use std::sync::Arc;

use gleaner_bucket::UrlReader;
use gleaner_core::{Secret, error::Result, id::BlobId};

/// The calls to the server of a data folder, which has the credentials of its bucket.
pub trait BlobServer: std::fmt::Debug + Send + Sync {
    /// The size of a blob and what `want` asks for; `None` when the blob is missing.
    ///
    /// # Errors
    /// Unavailable while the server or the store fails; Internal when the object is damaged.
    fn locate(&self, id: &BlobId, want: Want) -> Result<Option<Located>>;

    /// Has the server store the file that was handed over, by [`Blobs::take`](super::Blobs::take).
    ///
    /// # Errors
    /// NotFound when there is neither a file nor the blob; Unavailable while the server or the store fails.
    fn store(&self, id: &BlobId) -> Result<()>;
}

/// What a process without credentials wants of a blob.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Want {
    /// Its size.
    Size,
    /// Its content: a URL if one is accepted and the server signs one, or else a copy in the data folder.
    Content {
        /// Whether a URL is accepted.
        accept_url: bool,
    },
}

/// Where a blob is.
#[derive(Debug)]
pub struct Located {
    /// Its size in bytes.
    pub size_bytes: u64,
    /// A URL that returns its content for a short time. `None`: its copy is in the data folder, if the content was wanted.
    pub url: Option<Secret>,
}

/// The way of this process to the bucket by the server.
#[derive(Debug)]
pub(super) struct ByServer {
    pub(super) calls: Arc<dyn BlobServer>,
    pub(super) urls: UrlReader,
}

impl ByServer {
    pub(super) fn new(calls: Arc<dyn BlobServer>) -> Self {
        Self { calls, urls: UrlReader::default() }
    }

    pub(super) fn size(&self, id: &BlobId) -> Result<Option<u64>> {
        Ok(self.calls.locate(id, Want::Size)?.map(|found| found.size_bytes))
    }
}
