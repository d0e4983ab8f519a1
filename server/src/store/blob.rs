//! Which rows name a blob: asked before a blob is removed, because equal content shares one file.

use super::{Store, fault};
use crate::{domain::id::BlobId, error::Result};

impl Store {
    /// Whether any row names this blob.
    pub(crate) async fn names_blob(&self, blob: &BlobId) -> Result<bool> {
        sqlx::query_scalar(
            "select exists (select 1 from jobs where checkpoint = ?1) \
             or exists (select 1 from encoders where checkpoint = ?1) \
             or exists (select 1 from policies where checkpoint = ?1) \
             or exists (select 1 from export_files where blob = ?1) \
             or exists (select 1 from episodes where recording = ?1)",
        )
        .bind(blob.as_str())
        .fetch_one(self.read())
        .await
        .map_err(fault("asking who names a blob"))
    }
}
