//! Lists of datasets.

use super::{
    fault,
    row::{self, Column as _},
    sql,
};
use crate::{
    domain::{
        dataset::Dataset,
        id::{DatasetId, ScoreRunId, TaskId},
        page::Page,
    },
    error::Result,
    store::{Store, page::newest_first, sql::QueryBuilder},
};

impl Store {
    /// A task's datasets, newest first.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn datasets(&self, task: &TaskId) -> Result<Vec<Dataset>> {
        Ok(self.datasets_page(task, &Page::whole()).await?.0)
    }

    /// A page of a task's datasets, newest first, and the dataset that the next one follows.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn datasets_page(
        &self,
        task: &TaskId,
        page: &Page<DatasetId>,
    ) -> Result<(Vec<Dataset>, Option<DatasetId>)> {
        let mut query = QueryBuilder::new("select * from datasets where task_id = ");
        query.push_bind(task.param());
        let found = newest_first(self.read(), query, page, |dataset: &Dataset| dataset.id.clone()).await;
        found.map_err(fault("reading datasets"))
    }

    /// The datasets of a score run, newest first.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn datasets_of_run(&self, run: &ScoreRunId) -> Result<Vec<Dataset>> {
        sql::query("select * from datasets where score_run_id = $1 order by id desc")
            .bind(run.param())
            .try_map(row::read)
            .fetch_all(self.read())
            .await
            .map_err(fault("reading a run's datasets"))
    }
}
