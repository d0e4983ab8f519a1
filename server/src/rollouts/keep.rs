//! Stores a session's recording as an episode: salvages it if a crash has torn it, passes it to `ingest`, then removes
//! it. Every step can be repeated after a crash in the middle.

use super::{
    Rollouts, off_runtime,
    sidecar::{RolloutFiles, RolloutSidecar},
};
use crate::{
    domain::id::EpisodeId,
    error::{Error, Kind, Result},
    ingest::NewRecording,
};

/// The fewest steps of an episode.
const FEWEST: u64 = 2;

impl Rollouts {
    /// Stores a session's recording; `None` when it is too short, in which case it is removed.
    ///
    /// # Errors
    /// Invalid or NotFound when the recording is unusable and was set aside; other kinds when it cannot be stored now
    /// and the next start retries.
    pub(super) async fn keep(&self, files: &RolloutFiles) -> Result<Option<EpisodeId>> {
        match self.store(files).await {
            Err(error) if matches!(error.kind(), Kind::Invalid | Kind::NotFound) => {
                let aside = files.clone();
                off_runtime("recording a session", move || aside.set_aside()).await?;
                tracing::error!(
                    %error, file.path = %files.unusable().display(),
                    "a session's recording is unusable and was set aside"
                );
                Err(error)
            }
            stored => stored,
        }
    }

    async fn store(&self, files: &RolloutFiles) -> Result<Option<EpisodeId>> {
        let read = files.clone();
        let Some(mut sidecar) = off_runtime("recording a session", move || read.read()).await? else {
            return Err(Error::invalid("recording", "its sidecar is missing"));
        };
        let steps = match sidecar.steps {
            Some(steps) => steps,
            None => self.salvage(files, &mut sidecar).await?,
        };
        let episode = match steps {
            FEWEST.. => {
                let session = &sidecar.session;
                let new = NewRecording {
                    task_id: session.task_id.clone(),
                    file_name: format!("{}.mcap", session.session_id),
                    outcome: sidecar.outcome,
                    cohort: session.cohort.clone(),
                    author: session.session_id.to_string(),
                };
                Some(self.0.ingest.keep(new, &files.recording()).await?.id)
            }
            _ => None,
        };
        crate::fail_point::pass("rollout.kept");
        let done = files.clone();
        off_runtime("recording a session", move || done.remove()).await?;
        Ok(episode)
    }

    /// Salvages a torn recording and returns its steps.
    async fn salvage(&self, files: &RolloutFiles, sidecar: &mut RolloutSidecar) -> Result<u64> {
        let steps = self.0.ingest.salvage(&files.recording(), &files.salvaged()).await?;
        sidecar.steps = Some(steps);
        let (files, sidecar) = (files.clone(), sidecar.clone());
        off_runtime("recording a session", move || {
            if steps >= FEWEST {
                files.replace()?;
            }
            files.write(&sidecar)
        })
        .await?;
        tracing::info!(recording.steps = steps, "salvaged a session's recording that a crash had torn");
        Ok(steps)
    }
}
