//! The table of a task's episodes: every one that matches a filter, with its newest label.

use std::collections::HashMap;

use crate::{
    domain::{
        curation::{SortKey, TableFilter, TableRow},
        id::{EpisodeId, TaskId},
    },
    error::{Error, Result},
    store::{
        Store,
        episode::episode_columns,
        fault,
        row::{self, Column as _, record},
        sql::QueryBuilder,
    },
};

record! { TableRow: label_version, labelled_by, labelled_at; episode }

const LISTING: &str = "listing a table of episodes";

/// The query of episodes with their newest labels; conditions follow.
macro_rules! labelled {
    () => {
        concat!(
            "select ",
            episode_columns!(),
            ", labels.id as label_version, author as labelled_by, labels.created_at as labelled_at \
             from episodes join labels on labels.id = (select max(id) from labels where episode_id = episodes.id) where "
        )
    };
}

impl Store {
    /// Every episode of a task that matches the filter, oldest first.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn episode_table(&self, task: &TaskId, filter: &TableFilter) -> Result<Vec<TableRow>> {
        query(task, filter).build().try_map(row::read).fetch_all(self.read()).await.map_err(fault(LISTING))
    }

    /// The ids of a task's episodes that match the filter, in no order.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn matching_episodes(&self, task: &TaskId, filter: &TableFilter) -> Result<Vec<EpisodeId>> {
        let ids: Option<String> =
            ids(task, filter).build().try_map(row::read).fetch_one(self.read()).await.map_err(fault(LISTING))?;
        let ids = ids.iter().flat_map(|ids| ids.split(',')).map(|id| EpisodeId::try_from(id.to_owned()));
        ids.collect::<std::result::Result<_, _>>().map_err(|problem| Error::internal(LISTING, problem))
    }

    /// These episodes with their newest labels, in the order of `ids`; an unknown id is left out.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn episode_rows(&self, ids: &[EpisodeId]) -> Result<Vec<TableRow>> {
        let mut query = QueryBuilder::new(concat!(labelled!(), "episodes.id in ("));
        query.push_list(ids.iter().map(EpisodeId::as_str)).push(")");
        let mut rows: Vec<TableRow> =
            query.build().try_map(row::read).fetch_all(self.read()).await.map_err(fault(LISTING))?;
        let places: HashMap<&EpisodeId, usize> = ids.iter().zip(0..).collect();
        rows.sort_by_key(|row| places.get(&row.episode.id).copied());
        Ok(rows)
    }

    /// The number of a task's episodes that match the filter.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn count_episodes(&self, task: &TaskId, filter: &TableFilter) -> Result<u64> {
        let mut query = QueryBuilder::new("select count(*) from episodes where task_id = ");
        push_conditions(&mut query, task, filter);
        query.build().try_map(row::read).fetch_one(self.read()).await.map_err(fault("counting episodes"))
    }

    /// Of the task's episodes that match the filter, sorted by a key other than the mean q: up to `most` behind the first
    /// `skip`.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn episode_page(
        &self,
        task: &TaskId,
        filter: &TableFilter,
        order: (SortKey, bool),
        (skip, most): (usize, usize),
    ) -> Result<Vec<TableRow>> {
        let number = |count: usize| i64::try_from(count).unwrap_or(i64::MAX);
        page(task, filter, order, number(skip), number(most))
            .build()
            .try_map(row::read)
            .fetch_all(self.read())
            .await
            .map_err(fault("listing a page of episodes"))
    }
}

/// The episodes of a task that match the filter, with their labels, oldest first.
fn query(task: &TaskId, filter: &TableFilter) -> QueryBuilder {
    let mut query = QueryBuilder::new(concat!(labelled!(), "task_id = "));
    push_conditions(&mut query, task, filter);
    query.push(" order by episodes.id");
    query
}

/// The ids of the episodes of a task that match the filter, as one text: 100,000 rows of one id each take several times
/// as long.
fn ids(task: &TaskId, filter: &TableFilter) -> QueryBuilder {
    let mut query = QueryBuilder::new("select string_agg(id, ',') from episodes where task_id = ");
    push_conditions(&mut query, task, filter);
    query
}

/// One page of them. Only the ids are sorted, and only the page's rows meet their labels.
fn page(task: &TaskId, filter: &TableFilter, order: (SortKey, bool), skip: i64, most: i64) -> QueryBuilder {
    let (key, descending) = order;
    let direction = if descending { " desc" } else { "" };
    // Ids are in the order of time, and an index has them by task. Equal keys are in the order of their ids.
    let order = match key {
        SortKey::Date | SortKey::MeanQ => format!(" order by episodes.id{direction}"),
        SortKey::Steps => format!(" order by steps{direction}, episodes.id"),
        SortKey::Outcome => format!(" order by episodes.outcome{direction}, episodes.id"),
        SortKey::Cohort => format!(" order by episodes.cohort{direction}, episodes.id"),
        SortKey::Findings => format!(" order by warnings{direction}, episodes.id"),
    };
    let mut query = QueryBuilder::new(concat!(labelled!(), "episodes.id in (select id from episodes where task_id = "));
    push_conditions(&mut query, task, filter);
    query.push(&order).push(" limit ").push_bind(most).push(" offset ").push_bind(skip).push(")").push(&order);
    query
}

/// Adds the task and the conditions of a filter behind `where task_id = `.
fn push_conditions(query: &mut QueryBuilder, task: &TaskId, filter: &TableFilter) {
    let TableFilter { outcome, cohort, from, before, warnings, text } = filter;
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
}

#[cfg(test)]
mod tests;
