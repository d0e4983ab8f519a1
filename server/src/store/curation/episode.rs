//! Queries of an episode's page beyond the episode itself.

use crate::{
    domain::id::{EpisodeId, ScoreRunId, TaskId},
    error::{Error, Result},
    store::{
        Store, fault,
        row::{self, Column as _},
        sql,
    },
};

impl Store {
    /// The version of an episode's newest label, an argument of [`Store::label_episodes_as_seen`].
    ///
    /// # Errors
    /// NotFound.
    pub(crate) async fn label_version(&self, id: &EpisodeId) -> Result<i64> {
        let newest: Option<i64> = row::query_as("select max(id) from labels where episode_id = $1")
            .bind(id.param())
            .fetch_one(self.read())
            .await
            .map_err(fault("reading a label"))?;
        newest.ok_or_else(|| Error::not_found("episode", id))
    }

    /// The finished score runs of a task that scored this episode, newest first.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn runs_that_scored(&self, task: &TaskId, id: &EpisodeId) -> Result<Vec<ScoreRunId>> {
        sql::query(
            "select score_runs.id from episode_scores join score_runs on score_runs.id = score_run_id \
             where episode_id = $1 and task_id = $2 order by score_runs.id desc",
        )
        .bind(id.param())
        .bind(task.param())
        .try_map(row::read)
        .fetch_all(self.read())
        .await
        .map_err(fault("looking for an episode's runs"))
    }
}
