//! Uploads: from bytes to an inspected episode, or to an error.
//!
//! Bytes gather in a part file. A finished upload is inspected in a child process with limits, because reading hostile
//! bytes can abort a process. Only accepted recordings become a blob and a row. Must not depend on wire types.

mod claim;
#[cfg(test)]
mod contract;
mod describe;
mod existing;
mod fair_queue;
mod frames;
mod inspector;
mod keep;
mod limits;
mod part;
mod passing;
mod recover;
mod scored;
mod slots;
#[cfg(test)]
pub(crate) mod testing;
#[cfg(test)]
mod tests;
mod upload;
mod write;

use std::{
    path::{Path, PathBuf},
    sync::Arc,
    time::Duration,
};

use tokio::sync::Semaphore;

use self::{claim::Claims, inspector::Inspector, slots::Slots};
pub(crate) use self::{
    frames::Frames,
    keep::NewRecording,
    passing::{Declared, InspectionPermit, Passing},
    scored::ScoredCopy,
    upload::Started,
    write::Chunk,
};
use crate::{
    blobs::{Blobs, sync_folder},
    blocking::off_runtime,
    config::ServeConfig,
    domain::id::UploadId,
    error::Result,
    store::Store,
};

/// Handle to the uploads of one data directory; clones share it.
#[derive(Debug, Clone)]
pub struct Ingest {
    store: Store,
    blobs: Blobs,
    claims: Claims,
    inspector: Arc<Inspector>,
    /// One for each recording that is inspected and not stored.
    passing: Arc<Semaphore>,
    /// One for each copy of an episode with scores that is read.
    scored: Slots,
    data_dir: Arc<Path>,
    max_upload_bytes: u64,
    /// `None`: no limit.
    max_open_uploads: Option<u64>,
    /// How long an inactive upload is kept.
    keep_for: Duration,
}

impl Ingest {
    /// Opens the uploads and repairs them after a crash: see `recover`.
    ///
    /// # Errors
    /// Internal when the data directory or the database cannot be used.
    pub async fn open(config: &Arc<ServeConfig>, store: Store, blobs: Blobs) -> Result<Self> {
        let ingest = Self::new(config, store, blobs)?;
        ingest.recover().await?;
        Ok(ingest)
    }

    /// The uploads before they are repaired: a standby leaves that to its leader.
    ///
    /// # Errors
    /// Internal when the program that inspects cannot be found.
    pub(crate) fn new(config: &Arc<ServeConfig>, store: Store, blobs: Blobs) -> Result<Self> {
        Ok(Self {
            store,
            blobs,
            claims: Claims::default(),
            inspector: Arc::new(Inspector::new(&config.data_dir, &config.limits)?),
            passing: Arc::new(Semaphore::new(passing::AT_ONCE)),
            scored: Slots::new(scored::AT_ONCE),
            data_dir: config.data_dir.as_path().into(),
            max_upload_bytes: config.limits.max_upload_bytes,
            max_open_uploads: config.uploads.max_open_per_client(),
            keep_for: config.uploads.keep_for(),
        })
    }

    /// Repairs the uploads of an earlier server.
    ///
    /// # Errors
    /// As [`Ingest::open`].
    pub(crate) async fn recover(&self) -> Result<()> {
        recover::recover(&self.data_dir, &self.store, &self.blobs).await
    }

    /// Rejects a change unless this server leads.
    ///
    /// # Errors
    /// As [`Store::expect_leader`].
    pub(crate) fn expect_leader(&self) -> Result<()> {
        self.store.expect_leader()
    }

    /// The folder of recordings.
    pub(crate) fn blobs(&self) -> &Blobs {
        &self.blobs
    }

    fn part_path(&self, upload: &UploadId) -> PathBuf {
        part_path(&self.data_dir, upload)
    }
}

/// The part file of an open upload.
pub(crate) fn part_path(data_dir: &Path, upload: &UploadId) -> PathBuf {
    data_dir.join("uploads").join(format!("{upload}.part"))
}
