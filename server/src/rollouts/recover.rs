//! At start: stores recordings that an earlier run has left, one after the other. Unusable ones do not stop the start.

use std::{collections::BTreeSet, fs, io::ErrorKind};

use tracing::Instrument as _;

use super::{
    Rollouts, off_runtime,
    sidecar::{RolloutFiles, fault},
};
use crate::error::{Kind, Result};

impl Rollouts {
    /// The sessions with files in the folder. A partial salvage is removed.
    pub(super) fn left(&self) -> Result<BTreeSet<String>> {
        let folder = self.folder();
        let mut sessions = BTreeSet::new();
        for entry in fs::read_dir(folder).map_err(fault("listing", folder))? {
            let path = entry.map_err(fault("listing", folder))?.path();
            if path.extension().is_some_and(|extension| extension == "partial") {
                fs::remove_file(&path).map_err(fault("removing", &path))?;
                continue;
            }
            if let (true, Some(session)) = (path.is_file(), path.file_stem().and_then(|stem| stem.to_str())) {
                sessions.insert(session.to_owned());
            }
        }
        Ok(sessions)
    }

    /// Stores their recordings.
    pub(super) async fn recover(&self, sessions: BTreeSet<String>) {
        for session in sessions {
            let files = RolloutFiles::new(self.folder(), &session);
            let span = tracing::info_span!("rollout", session.id = session);
            self.recover_one(files).instrument(span).await;
        }
    }

    async fn recover_one(&self, files: RolloutFiles) {
        let files_of_session = files.clone();
        // Without a recording, or with an empty one, there are no steps to store. One that cannot be read now may have some.
        let empty = off_runtime("recording a session", move || {
            let path = files_of_session.recording();
            match fs::metadata(&path) {
                Ok(file) if file.len() > 0 => Ok(false),
                Err(error) if error.kind() != ErrorKind::NotFound => Err(fault("reading", &path)(error)),
                Ok(_) | Err(_) => files_of_session.remove().map(|()| true),
            }
        });
        let kept = match empty.await {
            Ok(true) => return,
            Ok(false) => self.keep(&files).await,
            Err(error) => Err(error),
        };
        match kept {
            Ok(Some(episode)) => tracing::info!(episode.id = %episode, "stored the recording of an earlier session"),
            Ok(None) => tracing::info!("a session of fewer than two steps is not stored"),
            // Logged where it was set aside.
            Err(error) if matches!(error.kind(), Kind::Invalid | Kind::NotFound) => {}
            Err(error) if super::passes(&error) => {
                // If the server stops first, the next start stores it.
                let _: Option<()> = self.0.stopping.run_until_cancelled(self.keep_later(&files)).await;
            }
            Err(error) => tracing::error!(
                error = &error as &dyn std::error::Error, file.path = %files.recording().display(),
                "the recording of an earlier session cannot be stored now; the next start retries"
            ),
        }
    }
}
