//! Counts of a run's kept segments: q and w are read in one pass, row by row on the database's own thread, so that a
//! large run does not block the runtime.

use futures::TryStreamExt as _;

use super::{Store, fault, packed::unpack, row};
use crate::{
    domain::{
        id::{EpisodeId, ScoreRunId},
        score::Histogram,
        selection::{Candidate, Selection, WhatIf, count},
    },
    error::{Error, Result},
};

#[derive(sqlx::FromRow)]
struct CandidateRow {
    episode_id: String,
    cohort: String,
    w: Vec<u8>,
    q: Vec<u8>,
}

impl CandidateRow {
    fn candidate(self) -> Result<Candidate> {
        Ok(Candidate {
            episode_id: row::id("episode_scores.episode_id", self.episode_id)?,
            cohort: self.cohort,
            w: unpack("episode_scores.w", &self.w)?.collect(),
            q: unpack("episode_scores.q", &self.q)?.collect(),
        })
    }
}

impl Store {
    /// Fills a histogram with the q of a run's imperfect segments.
    ///
    /// # Errors
    /// As for [`Store::score_run`].
    pub(crate) async fn fill(&self, run: &ScoreRunId, mut histogram: Histogram) -> Result<Histogram> {
        self.score_run(run).await?;
        let mut rows = sqlx::query_scalar::<_, Vec<u8>>(
            "select q from episode_scores where score_run_id = ? and role = 'imperfect' order by position",
        )
        .bind(run.as_str())
        .fetch(self.read());
        while let Some(q) = rows.try_next().await.map_err(fault("reading a run's q"))? {
            histogram.add(unpack("episode_scores.q", &q)?);
        }
        Ok(histogram)
    }

    /// The counts of each selection of a run.
    ///
    /// # Errors
    /// As for [`Store::score_run`].
    pub(crate) async fn count_kept(&self, run: &ScoreRunId, selections: Vec<Selection>) -> Result<Vec<WhatIf>> {
        let candidates = self.candidates(run).await?;
        let counting = tokio::task::spawn_blocking(move || count(&selections, &candidates));
        counting.await.map_err(|error| Error::internal("counting kept segments", error))
    }

    /// w and q of a run's imperfect episodes, in the snapshot's order, with their cohorts in that snapshot.
    ///
    /// # Errors
    /// As for [`Store::score_run`].
    pub(crate) async fn candidates(&self, run: &ScoreRunId) -> Result<Vec<Candidate>> {
        let snapshot = self.score_run(run).await?.snapshot_id;
        let mut rows = sqlx::query_as::<_, CandidateRow>(
            "select episode_scores.episode_id, cohort, w, q from episode_scores join snapshot_episodes \
             on snapshot_id = ? and snapshot_episodes.episode_id = episode_scores.episode_id \
             where score_run_id = ? and episode_scores.role = 'imperfect' order by episode_scores.position",
        )
        .bind(snapshot.as_str())
        .bind(run.as_str())
        .fetch(self.read());
        let mut candidates = Vec::new();
        while let Some(found) = rows.try_next().await.map_err(fault("reading a run's scores"))? {
            candidates.push(found.candidate()?);
        }
        Ok(candidates)
    }

    /// The episodes with scores in a run, in the snapshot's order, for reading them one by one.
    ///
    /// # Errors
    /// As for [`Store::score_run`].
    pub(crate) async fn scored_episodes(&self, run: &ScoreRunId) -> Result<Vec<EpisodeId>> {
        let ids: Vec<String> =
            sqlx::query_scalar("select episode_id from episode_scores where score_run_id = ? order by position")
                .bind(run.as_str())
                .fetch_all(self.read())
                .await
                .map_err(fault("listing a run's episodes"))?;
        ids.into_iter().map(|id| row::id("episode_scores.episode_id", id)).collect()
    }
}
