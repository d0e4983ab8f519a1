//! Copies of stored recordings with scores beside their messages.

use std::path::{Path, PathBuf};

use gleaner_inspector::Order;
use gleaner_recording::{Kept, TaskSpec};
use tempfile::TempDir;

use super::{FRAMES, Inspector};
use crate::{
    domain::client::Client,
    error::{Error, Kind, Result},
    ingest::off_runtime,
};

const SCORES: &str = "scores.json";

/// A copy of a recording with scores, removed on drop.
#[derive(Debug)]
pub(in crate::ingest) struct Extracted {
    folder: TempDir,
}

impl Extracted {
    /// The file.
    pub(in crate::ingest) fn path(&self) -> PathBuf {
        self.folder.path().join(FRAMES)
    }
}

impl Inspector {
    /// Copies a stored recording with these scores beside its messages, under the same limits.
    ///
    /// # Errors
    /// Internal when the recording can no longer be read or the copy exceeds a limit; Exhausted; Unavailable.
    pub(in crate::ingest) async fn extract(
        &self,
        client: &Client,
        recording: &Path,
        spec: &TaskSpec,
        kept: Kept,
    ) -> Result<Extracted> {
        let _slot = self.slots.take(client).await?;
        let folder = self.prepare(Some(spec)).await?;
        let scores = folder.path().join(SCORES);
        let order = Order { extract: Some(scores.clone()), ..self.order(recording, folder.path()).await? };
        off_runtime("writing scores", move || {
            let json = serde_json::to_vec(&kept).map_err(|error| Error::internal("writing scores", error))?;
            std::fs::write(scores, json).map_err(|error| Error::internal("writing scores", error))
        })
        .await?;
        match self.verdict(&order, "the stored recording").await {
            Ok(_) => Ok(Extracted { folder }),
            // It was accepted before, so the caller is not at fault.
            Err(error) if error.kind() == Kind::Invalid => Err(Error::internal("copying a recording", error)),
            Err(error) => Err(error),
        }
    }
}
