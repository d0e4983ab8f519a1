//! The rows that name a blob: needed before a blob is removed, because equal content shares one file, and by `check`
//! and `backup`, which process all blobs.

use super::{
    Store, fault,
    row::{self, Column as _, record},
    sql::{self, Target},
};
use crate::{
    domain::id::{BlobId, ExportId},
    error::Result,
};

/// The one list of the columns that name blobs: the blob, the row that needs it, and its size where the row has it.
macro_rules! named_blobs {
    () => {
        // The setting `image_weights` ends in the digest of a blob, which is needed until its job has ended.
        "select recording as blob, id as needed_by, size_bytes from episodes where purged_at is null \
         union all select checkpoint, id, null from encoders \
         union all select checkpoint, id, null from policies where checkpoint is not null \
         union all select blob, export_id || ' (its file ' || name || ')', size_bytes from export_files \
         union all select checkpoint, id || ' (to resume from)', null from jobs where checkpoint is not null \
         union all select substr(weights, length(weights) - 63), id || ' (to begin with)', null from \
         (select id, case when json_valid(spec) then json_extract(spec, '$.spec.image_weights') end as weights \
          from jobs where state in ('queued', 'running')) as named where substr(weights, length(weights) - 64, 1) = '@'"
    };
}

record! { NamedBlob: blob, needed_by, size_bytes }

/// A blob that a row names.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct NamedBlob {
    /// The blob.
    pub(crate) blob: BlobId,
    /// The row's id: an episode, encoder, policy, export or job.
    pub(crate) needed_by: String,
    /// Its size according to the row.
    pub(crate) size_bytes: Option<u64>,
}

impl Store {
    /// Whether any row names this blob, or an open upload may be about to.
    pub(crate) async fn names_blob(&self, blob: &BlobId) -> Result<bool> {
        row::query_as(concat!(
            "select exists (select 1 from (",
            named_blobs!(),
            ") as named where blob = $1) or exists (select 1 from uploads where blake3 = $1 and committed = size_bytes)"
        ))
        .bind(blob.param())
        .fetch_one(self.read())
        .await
        .map_err(fault("reading the rows that name a blob"))
    }

    /// Whether any row beside those of this export's files names this blob, or an open upload may be about to.
    pub(crate) async fn names_blob_beside(&self, blob: &BlobId, export: &ExportId) -> Result<bool> {
        row::query_as(concat!(
            "select exists (select 1 from (",
            named_blobs!(),
            ") as named where blob = $1 and substr(needed_by, 1, length($2)) <> $2) \
             or exists (select 1 from uploads where blake3 = $1 and committed = size_bytes)"
        ))
        .bind(blob.param())
        .bind(export.param())
        .fetch_one(self.read())
        .await
        .map_err(fault("reading the other rows that name a blob"))
    }

    /// Every blob that a row names, once for each such row, sorted by blob; read at one moment.
    pub(crate) async fn named_blobs(&self) -> Result<Vec<NamedBlob>> {
        Self::named_blobs_on(self.read()).await
    }

    /// The same in a transaction.
    pub(super) async fn named_blobs_on(on: impl Into<Target<'_>>) -> Result<Vec<NamedBlob>> {
        sql::query(concat!(named_blobs!(), " order by 1, 2"))
            .try_map(row::read)
            .fetch_all(on)
            .await
            .map_err(fault("listing the blobs that rows name"))
    }
}
