//! At start: what an earlier run has left is kept, one after the other. Nothing that is wrong with it is in the way of
//! the start.

use std::{collections::BTreeSet, fs};

use tracing::Instrument as _;

use super::{
    Rollouts,
    about::{Place, fault},
    off_runtime,
};
use crate::error::{Kind, Result};

impl Rollouts {
    /// The sessions of which there is something. Half of a mended recording is nothing: it goes.
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

    /// Keeps what they left.
    pub(super) async fn recover(&self, sessions: BTreeSet<String>) {
        for session in sessions {
            let place = Place::new(self.folder(), &session);
            let span = tracing::info_span!("rollout", session.id = session);
            self.recover_one(place).instrument(span).await;
        }
    }

    async fn recover_one(&self, place: Place) {
        let look = place.clone();
        // Without a recording, or without a byte of it, nothing was ever written down.
        let empty = off_runtime(move || {
            let size = fs::metadata(look.recording()).map_or(0, |file| file.len());
            if size == 0 { look.remove().map(|()| true) } else { Ok(false) }
        });
        let kept = match empty.await {
            Ok(true) => return,
            Ok(false) => self.keep(&place).await,
            Err(error) => Err(error),
        };
        match kept {
            Ok(Some(episode)) => tracing::info!(episode.id = %episode, "kept what a session has left"),
            Ok(None) => tracing::info!("a session has left less than two steps: no episode"),
            // Said where it was set aside.
            Err(error) if matches!(error.kind(), Kind::Invalid | Kind::NotFound) => {}
            Err(error) if error.kind() == Kind::Exhausted => {
                // If the server stops first, the next start does it.
                let _: Option<()> = self.0.stopping.run_until_cancelled(self.keep_later(&place)).await;
            }
            Err(error) => tracing::error!(
                error = &error as &dyn std::error::Error, file.path = %place.recording().display(),
                "what a session has left cannot be kept now; the next start tries again"
            ),
        }
    }
}
