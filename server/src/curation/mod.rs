//! Scores of whole runs in memory, for the pages and for counts of selections, and single steps of recordings as images
//! and numbers, which only the pages need.
//!
//! Must not depend on pages, wire types or SQL.

mod picture;
mod steps;
mod summary;

use std::sync::{Arc, Mutex, PoisonError};

use quick_cache::sync::Cache;

pub(crate) use self::summary::Summary;
use self::{steps::Steps, summary::Weigh};
use crate::{
    domain::{
        id::{EpisodeId, ScoreRunId},
        selection::{Selection, WhatIf},
        steps::{FrameView, Numbers},
    },
    error::{Error, Kind, Result},
    ingest::Ingest,
    store::Store,
};

/// Maximum memory of cached runs' scores, in bytes.
const RUN_BYTES: u64 = 256 << 20;
/// Maximum number of mapped recordings kept open, for playback and for segments of several recordings.
const OPEN_RECORDINGS: usize = 64;

/// The caches of the pages; clones share them.
#[derive(Clone)]
pub(crate) struct Curation(Arc<Inner>);

struct Inner {
    store: Store,
    ingest: Ingest,
    runs: Cache<ScoreRunId, Arc<Summary>, Weigh>,
    open: Cache<EpisodeId, Arc<Steps>>,
    /// The last run that was summed up ahead of use: once evicted, it is not loaded again and again.
    warmed: Mutex<Option<ScoreRunId>>,
}

impl Curation {
    /// An empty cache.
    pub(crate) fn new(store: Store, ingest: Ingest) -> Self {
        let runs = Cache::with_weighter(16, RUN_BYTES, Weigh);
        Self(Arc::new(Inner { store, ingest, runs, open: Cache::new(OPEN_RECORDINGS), warmed: Mutex::default() }))
    }

    /// A finished run's scores of its imperfect episodes, read once for concurrent callers and cached by use.
    ///
    /// # Errors
    /// NotFound; Precondition when the run's job has not succeeded.
    pub(crate) async fn summary(&self, run: &ScoreRunId) -> Result<Arc<Summary>> {
        let load = async {
            let of = self.0.store.score_run(run).await?;
            let candidates = self.0.store.candidates(run, true).await?;
            let experts = self.0.store.expert_qualities(run).await?;
            off_runtime("summing up a run", move || Ok(Arc::new(Summary::new(of, candidates, experts)))).await
        };
        self.0.runs.get_or_insert_async(run, load).await
    }

    /// The counts of each selection of a run; the same as [`Store::count_kept`], which reads the run each time.
    ///
    /// # Errors
    /// As for [`Curation::summary`].
    pub(crate) async fn count_kept(&self, run: &ScoreRunId, selections: Vec<Selection>) -> Result<Vec<WhatIf>> {
        let summary = self.summary(run).await?;
        let mut counts = Vec::with_capacity(selections.len());
        for selection in selections {
            counts.push(summary.what_if(selection).await?);
        }
        Ok(counts)
    }

    /// Loads the newest run ahead of its first use.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn warm(&self) -> Result<()> {
        let Some(newest) = self.0.store.newest_run().await? else { return Ok(()) };
        let before = self.0.warmed.lock().unwrap_or_else(PoisonError::into_inner).replace(newest.clone());
        if before.as_ref() != Some(&newest) {
            self.summary(&newest).await?.warm().await?;
        }
        Ok(())
    }

    /// One step of an episode from one of its cameras, as JPEG.
    ///
    /// # Errors
    /// NotFound names the missing episode, step or camera; Invalid a size of 0, or depth that the camera does not have.
    pub(crate) async fn frame(&self, episode: &EpisodeId, view: FrameView) -> Result<Vec<u8>> {
        let steps = self.steps(episode).await?;
        off_runtime("drawing a frame", move || steps.frame(&view)).await
    }

    /// The numbers of every step of an episode.
    ///
    /// # Errors
    /// NotFound.
    pub(crate) async fn numbers(&self, episode: &EpisodeId) -> Result<Numbers> {
        let steps = self.steps(episode).await?;
        off_runtime("reading an episode's numbers", move || Ok(steps.numbers())).await
    }

    /// The steps of an episode, mapped.
    async fn steps(&self, episode: &EpisodeId) -> Result<Arc<Steps>> {
        // Read at each call, so that a deleted episode is no longer shown.
        let (task, recording) = match self.0.store.recording_of(episode).await {
            Ok(found) => found,
            Err(error) => {
                if error.kind() == Kind::NotFound {
                    self.0.open.remove(episode);
                }
                return Err(error);
            }
        };
        let open = async {
            let spec = self.0.store.task_by_id(&task).await?.spec;
            let decoded = self.0.ingest.frames(&spec, &recording).await?;
            Ok(Arc::new(Steps::new(episode.clone(), spec, decoded)))
        };
        self.0.open.get_or_insert_async(episode, open).await
    }
}

/// Runs blocking work off the runtime's threads.
async fn off_runtime<T: Send + 'static>(
    doing: &'static str,
    work: impl FnOnce() -> Result<T> + Send + 'static,
) -> Result<T> {
    tokio::task::spawn_blocking(work).await.map_err(|error| Error::internal(doing, error))?
}

#[cfg(test)]
mod tests;
