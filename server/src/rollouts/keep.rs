//! From a recording to an episode: mended if a crash has torn it, stored by the door that uploads use, then gone from
//! here. Every step can be done again after a crash in its middle.

use super::{
    Rollouts,
    about::{Place, Slip},
    off_runtime,
};
use crate::{
    domain::id::EpisodeId,
    error::{Error, Kind, Result},
    ingest::NewRecording,
};

/// The fewest steps of an episode.
const FEWEST: u64 = 2;

impl Rollouts {
    /// Stores a session's recording; `None` when there is too little of it, which then is gone.
    ///
    /// # Errors
    /// Invalid or NotFound when it cannot be used: it is set aside then; others when it cannot be stored now: the next
    /// start tries again.
    pub(super) async fn keep(&self, place: &Place) -> Result<Option<EpisodeId>> {
        match self.store(place).await {
            Err(error) if matches!(error.kind(), Kind::Invalid | Kind::NotFound) => {
                let aside = place.clone();
                off_runtime(move || aside.set_aside()).await?;
                tracing::error!(
                    %error, file.path = %place.unusable().display(),
                    "a session's recording cannot be used and is set aside"
                );
                Err(error)
            }
            stored => stored,
        }
    }

    async fn store(&self, place: &Place) -> Result<Option<EpisodeId>> {
        let read = place.clone();
        let Some(mut slip) = off_runtime(move || read.read()).await? else {
            return Err(Error::invalid("recording", "nothing is known of its session"));
        };
        let steps = match slip.steps {
            Some(steps) => steps,
            None => self.mend(place, &mut slip).await?,
        };
        let episode = match steps {
            FEWEST.. => {
                let about = &slip.about;
                let new = NewRecording {
                    task_id: about.task_id.clone(),
                    file_name: format!("{}.mcap", about.session_id),
                    outcome: slip.outcome,
                    cohort: about.cohort.clone(),
                    author: about.session_id.to_string(),
                };
                Some(self.0.ingest.keep(new, &place.recording()).await?.id)
            }
            _ => None,
        };
        crate::fail_point::pass("rollout.kept");
        let done = place.clone();
        off_runtime(move || done.remove()).await?;
        Ok(episode)
    }

    /// Makes a whole file of a torn one, and gives its steps.
    async fn mend(&self, place: &Place, slip: &mut Slip) -> Result<u64> {
        let steps = self.0.ingest.salvage(&place.recording(), &place.mended()).await?;
        slip.steps = Some(steps);
        let (place, slip) = (place.clone(), slip.clone());
        off_runtime(move || {
            if steps >= FEWEST {
                place.replace()?;
            }
            place.write(&slip)
        })
        .await?;
        tracing::info!(recording.steps = steps, "mended what a crash has left of a session");
        Ok(steps)
    }
}
