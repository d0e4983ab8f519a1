//! Counts of a run's kept segments: q and w are read in one pass, row by row on the database's own thread, so that a
//! large run does not block the runtime.

use futures::TryStreamExt as _;

use super::{
    Store, fault,
    row::{self, Column as _, record},
};
use crate::{
    domain::{
        id::{EpisodeId, ScoreRunId},
        score::{Histogram, expert_auroc},
        selection::{Candidate, Selection, WhatIf, count},
        snapshot::Role,
    },
    error::{Error, Result},
};

record! { Candidate: episode_id, cohort, w, q }

impl Store {
    /// Fills a histogram with the q of a run's imperfect segments and of its experts; also returns the AUROC between the
    /// two, as [`expert_auroc`].
    ///
    /// # Errors
    /// As for [`Store::score_run`].
    pub(crate) async fn fill(&self, run: &ScoreRunId, mut histogram: Histogram) -> Result<(Histogram, Option<f64>)> {
        self.score_run(run).await?;
        let mut rows = sqlx::query("select role, q from episode_scores where score_run_id = ? order by position")
            .bind(run.param())
            .try_map(row::read::<(Role, Vec<f32>)>)
            .fetch(self.read());
        let (mut imperfect, mut experts) = (Vec::new(), Vec::new());
        while let Some((role, q)) = rows.try_next().await.map_err(fault("reading a run's q"))? {
            match role {
                Role::Imperfect => histogram.add(q.iter().copied()),
                Role::Expert => histogram.add_expert(q.iter().copied()),
            }
            (if role == Role::Imperfect { &mut imperfect } else { &mut experts }).extend(q);
        }
        let comparing = tokio::task::spawn_blocking(move || expert_auroc(imperfect, experts));
        let auroc =
            comparing.await.map_err(|error| Error::internal("comparing experts with imperfect segments", error))?;
        Ok((histogram, auroc))
    }

    /// The q of each expert of a run, from its comparison with the other experts.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn expert_qualities(&self, run: &ScoreRunId) -> Result<Vec<Vec<f32>>> {
        sqlx::query("select q from episode_scores where score_run_id = ? and role = 'expert' order by position")
            .bind(run.param())
            .try_map(row::read)
            .fetch_all(self.read())
            .await
            .map_err(fault("reading the experts' q"))
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
        sqlx::query(
            "select episode_scores.episode_id, cohort, w, q from episode_scores join snapshot_episodes \
             on snapshot_id = ? and snapshot_episodes.episode_id = episode_scores.episode_id \
             where score_run_id = ? and episode_scores.role = 'imperfect' order by episode_scores.position",
        )
        .bind(snapshot.param())
        .bind(run.param())
        .try_map(row::read)
        .fetch_all(self.read())
        .await
        .map_err(fault("reading a run's scores"))
    }

    /// The episodes with scores in a run, in the snapshot's order, for reading them one by one.
    ///
    /// # Errors
    /// As for [`Store::score_run`].
    pub(crate) async fn scored_episodes(&self, run: &ScoreRunId) -> Result<Vec<EpisodeId>> {
        sqlx::query("select episode_id from episode_scores where score_run_id = ? order by position")
            .bind(run.param())
            .try_map(row::read)
            .fetch_all(self.read())
            .await
            .map_err(fault("listing a run's episodes"))
    }
}
