//! Scores of whole runs in memory, for the pages and for counts of selections, and single steps of recordings as images
//! and numbers, which only the pages need.
//!
//! Must not depend on pages, wire types or SQL.

mod picture;
mod scored;
mod steps;
mod summary;

use std::sync::{Arc, Mutex, PoisonError};

use quick_cache::sync::Cache;
use tokio::sync::Semaphore;

pub(crate) use self::summary::Summary;
use self::{steps::Steps, summary::Weigh};
use crate::{
    blocking::off_runtime,
    domain::{
        dataset::{Dataset, DatasetCounts},
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
/// Maximum number of runs that are read at once: a run has no place in the cache, and so no bound, until it is read.
const READS: usize = 2;
/// Maximum number of recordings whose frame cache stays checked, for playback and for segments of several recordings.
const OPEN_RECORDINGS: usize = 64;

/// The caches of the pages; clones share them.
#[derive(Clone)]
pub(crate) struct Curation(Arc<Inner>);

struct Inner {
    store: Store,
    ingest: Ingest,
    runs: Cache<ScoreRunId, Arc<Summary>, Weigh>,
    /// Places to read a run.
    reads: Semaphore,
    open: Cache<EpisodeId, Arc<Steps>>,
    /// The last run that was summed up ahead of use: once evicted, it is not loaded again and again.
    warmed: Mutex<Option<ScoreRunId>>,
}

impl Curation {
    /// An empty cache.
    pub(crate) fn new(store: Store, ingest: Ingest) -> Self {
        let runs = Cache::with_weighter(16, RUN_BYTES, Weigh);
        let (reads, open) = (Semaphore::new(READS), Cache::new(OPEN_RECORDINGS));
        Self(Arc::new(Inner { store, ingest, runs, reads, open, warmed: Mutex::default() }))
    }

    /// A finished run's scores of its imperfect episodes, read once for concurrent callers and cached by use.
    ///
    /// # Errors
    /// NotFound; Precondition when the run's job has not succeeded.
    pub(crate) async fn summary(&self, run: &ScoreRunId) -> Result<Arc<Summary>> {
        let load = async {
            let waiting = self.0.reads.acquire().await;
            let _place = waiting.map_err(|error| Error::internal("waiting to read a run", error))?;
            let of = self.0.store.score_run(run).await?;
            let candidates = self.0.store.candidates(run, true).await?;
            let experts = self.0.store.expert_qualities(run).await?;
            off_runtime("summing up a run", move || Ok(Arc::new(Summary::new(of, candidates, experts)))).await
        };
        self.0.runs.get_or_insert_async(run, load).await
    }

    /// The counts of each selection of a run.
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

    /// The counts of each dataset, in order; `None` while its score run is not finished. Counts a dataset once, and
    /// stores its counts.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn dataset_counts(&self, datasets: &[Dataset]) -> Result<Vec<Option<DatasetCounts>>> {
        let mut counts = Vec::with_capacity(datasets.len());
        for dataset in datasets {
            counts.push(self.counts_of(dataset).await?);
        }
        Ok(counts)
    }

    async fn counts_of(&self, dataset: &Dataset) -> Result<Option<DatasetCounts>> {
        if let Some(stored) = self.0.store.dataset_counts(&dataset.id).await? {
            return Ok(Some(stored));
        }
        let summary = match self.summary(&dataset.score_run_id).await {
            Ok(summary) => summary,
            Err(error) if error.kind() == Kind::Precondition => return Ok(None),
            Err(error) => return Err(error),
        };
        let kept = summary.what_if(dataset.selection).await?.total;
        // A database that cannot be written does not keep a caller from reading.
        if let Err(error) = self.0.store.keep_counts(&dataset.id, kept).await {
            tracing::warn!(dataset.id = %dataset.id, %error, "storing the counts of a dataset failed");
        }
        let expert_segments = self.0.store.run_counts(summary.run()).await?.expert_segments;
        Ok(Some(DatasetCounts { kept_segments: kept.segments, kept_episodes: kept.episodes, expert_segments }))
    }

    /// Loads the newest run ahead of its first use.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn warm(&self) -> Result<()> {
        let Some(newest) = self.0.store.newest_run().await? else { return Ok(()) };
        let before = self.0.warmed.lock().unwrap_or_else(PoisonError::into_inner).replace(newest.clone());
        if before.as_ref() != Some(&newest) { self.load(&newest).await } else { Ok(()) }
    }

    /// Loads a finished run with all that its pages and counts are made of.
    ///
    /// # Errors
    /// As for [`Curation::summary`].
    pub(crate) async fn load(&self, run: &ScoreRunId) -> Result<()> {
        self.summary(run).await?.warm().await
    }

    /// One step of an episode from one of its cameras, as JPEG.
    ///
    /// # Errors
    /// NotFound names the missing episode, step or camera; Invalid a size of 0, or depth that the camera does not have.
    pub(crate) async fn frame(&self, episode: &EpisodeId, view: FrameView) -> Result<Vec<u8>> {
        self.steps(episode).await?.frame(view).await
    }

    /// The numbers of every step of an episode.
    ///
    /// # Errors
    /// NotFound.
    pub(crate) async fn numbers(&self, episode: &EpisodeId) -> Result<Numbers> {
        self.steps(episode).await?.numbers().await
    }

    /// The steps of an episode.
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
            let frames = self.0.ingest.frames(&spec, &recording).await?;
            Ok(Arc::new(Steps::new(episode.clone(), spec, frames)))
        };
        self.0.open.get_or_insert_async(episode, open).await
    }
}

#[cfg(test)]
mod tests;
