//! Existing episodes of a content: the answer to a repeated push.

use super::{Ingest, off_runtime};
use crate::{
    domain::episode::{Episode, InspectedEpisode, Outcome, Upload},
    error::{Error, Result},
};

impl Ingest {
    /// The episode of this content, if its recording exists with its size; a lost or cut one can be pushed again.
    pub(super) async fn stored(&self, upload: &Upload) -> Result<Option<Episode>> {
        let existing = self.store.episode_of(&upload.task_id, &upload.blake3).await?;
        let (blobs, id, size) = (self.blobs.clone(), upload.blake3.clone(), upload.size_bytes);
        let there = move || Ok(blobs.size(&id)?.filter(|stored| *stored == size).map(drop));
        Ok(if existing.is_some() { off_runtime("looking for a recording", there).await?.and(existing) } else { None })
    }

    /// The answer when the content exists.
    pub(super) async fn settle_on(&self, existing: Episode, upload: &Upload) -> Result<InspectedEpisode> {
        let existing = same_label(existing, upload.outcome, &upload.cohort)?;
        self.store.episode(&existing.id).await
    }
}

/// The episode itself, if it has this label. An unknown outcome without a cohort of its own states no label, so it agrees
/// with any: a folder is pushed again without its labels.
pub(super) fn same_label(existing: Episode, outcome: Outcome, cohort: &str) -> Result<Episode> {
    if existing.deleted_at.is_some() {
        return Err(Error::exists(format!(
            "the task holds this recording as {0}, which is in the trash; to restore it: gleaner restore {0}",
            existing.id
        )));
    }
    let unstated = outcome == Outcome::Unknown && cohort.is_empty();
    let same_outcome = outcome == Outcome::Unknown || existing.outcome == outcome;
    if unstated || (same_outcome && existing.cohort == cohort) {
        return Ok(existing);
    }
    let cohort =
        if existing.cohort.is_empty() { "no cohort".to_owned() } else { format!("cohort {:?}", existing.cohort) };
    Err(Error::exists(format!(
        "the task holds this recording as {}, labelled {} with {cohort}: to change that: gleaner label {} --outcome …",
        existing.id,
        existing.outcome.as_str(),
        existing.id,
    )))
}
