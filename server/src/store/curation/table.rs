//! The table of a task's episodes: every one that matches a filter, with its newest label.

use sqlx::{QueryBuilder, Sqlite};

use crate::{
    domain::{
        curation::{TableFilter, TableRow},
        id::TaskId,
    },
    error::Result,
    store::{
        Store,
        episode::episode_columns,
        fault,
        row::{self, Column as _, record},
    },
};

record! { TableRow: label_version, labelled_by, labelled_at; episode }

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
        query(task, filter)
            .build()
            .try_map(row::read)
            .fetch_all(self.read())
            .await
            .map_err(fault("listing a table of episodes"))
    }
}

fn query(task: &TaskId, filter: &TableFilter) -> QueryBuilder<Sqlite> {
    let TableFilter { outcome, cohort, from, before, warnings, text } = filter;
    let mut query = QueryBuilder::<Sqlite>::new(TABLE);
    query.push_bind(task.param()).push(" and deleted_at is null");
    if let Some(outcome) = outcome {
        query.push(" and episodes.outcome = ").push_bind(outcome.param());
    }
    if let Some(cohort) = cohort {
        query.push(" and episodes.cohort = ").push_bind(cohort.clone());
    }
    if let Some(from) = from {
        query.push(" and episodes.created_at >= ").push_bind(from.param());
    }
    if let Some(before) = before {
        query.push(" and episodes.created_at < ").push_bind(before.param());
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
