//! The table of a task's episodes: every one that matches a filter, with its newest label.

use sqlx::{QueryBuilder, Sqlite};

use crate::{
    domain::{
        curation::{TableFilter, TableRow},
        id::TaskId,
        time::Millis,
    },
    error::Result,
    store::{
        Store,
        episode::{EpisodeRow, episode_columns},
        fault,
    },
};

#[derive(sqlx::FromRow)]
struct LabelledRow {
    #[sqlx(flatten)]
    episode: EpisodeRow,
    label_version: i64,
    labelled_by: String,
    labelled_at: i64,
}

impl LabelledRow {
    fn read(self) -> Result<TableRow> {
        Ok(TableRow {
            episode: self.episode.read()?,
            label_version: self.label_version,
            labelled_by: self.labelled_by,
            labelled_at: Millis(self.labelled_at),
        })
    }
}

const TABLE: &str = concat!(
    "select ",
    episode_columns!(),
    ", labels.id as label_version, author as labelled_by, labels.created_at as labelled_at from episodes join labels \
     on labels.id = (select max(id) from labels where episode_id = episodes.id) where task_id = "
);

impl Store {
    /// Every episode of a task that matches the filter, oldest first.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn episode_table(&self, task: &TaskId, filter: &TableFilter) -> Result<Vec<TableRow>> {
        let rows: Vec<LabelledRow> = query(task, filter)
            .build_query_as()
            .fetch_all(self.read())
            .await
            .map_err(fault("listing a table of episodes"))?;
        rows.into_iter().map(LabelledRow::read).collect()
    }
}

fn query(task: &TaskId, filter: &TableFilter) -> QueryBuilder<Sqlite> {
    let TableFilter { outcome, cohort, from, before, warnings, text } = filter;
    let mut query = QueryBuilder::<Sqlite>::new(TABLE);
    query.push_bind(task.as_str().to_owned()).push(" and deleted_at is null");
    if let Some(outcome) = outcome {
        query.push(" and episodes.outcome = ").push_bind(outcome.as_str());
    }
    if let Some(cohort) = cohort {
        query.push(" and episodes.cohort = ").push_bind(cohort.clone());
    }
    if let Some(from) = from {
        query.push(" and episodes.created_at >= ").push_bind(from.0);
    }
    if let Some(before) = before {
        query.push(" and episodes.created_at < ").push_bind(before.0);
    }
    if let Some(warnings) = warnings {
        query.push(if *warnings { " and warnings > 0" } else { " and warnings = 0" });
    }
    if let Some(text) = text {
        // Not `like`: the text may contain % and _.
        let text = text.to_ascii_lowercase();
        query.push(" and (instr(lower(file_name), ").push_bind(text.clone()).push(") > 0 ");
        query.push("or instr(lower(episodes.id), ").push_bind(text).push(") > 0)");
    }
    query.push(" order by episodes.id");
    query
}

#[cfg(test)]
mod tests;
