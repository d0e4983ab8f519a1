//! The bytes of a recording on this machine, with what is declared of them before they are sent.
//!
//! Reads files; must not know a server.

use std::path::{Path, PathBuf};

use gleaner_recording::{RecordingSummary, summarize};

use crate::digest::{Digest, digest_file};
use crate::error::Result;
use crate::file::{name_to_send, off_runtime};

/// A recording to send.
#[derive(Clone, Debug)]
pub(crate) struct Source {
    pub(crate) path: PathBuf,
}

/// What is declared of a recording before it is sent.
#[derive(Clone, Debug)]
pub(crate) struct Declared {
    pub(crate) file_name: String,
    pub(crate) digest: Digest,
    /// `None` where the file has no sound summary; the server finds its damage.
    pub(crate) summary: Option<RecordingSummary>,
}

impl Source {
    pub(crate) fn of(path: &Path) -> Self {
        Self { path: path.to_owned() }
    }

    /// Reads the recording through once.
    pub(crate) async fn declare(&self) -> Result<Declared> {
        let digest = digest_file(&self.path).await?;
        let path = self.path.clone();
        let summary = off_runtime(&self.path, move || Ok(summarize(&path).ok().flatten())).await?;
        Ok(Declared { file_name: name_to_send(&self.path), digest, summary })
    }
}
