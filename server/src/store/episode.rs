//! Rows of episodes; their labels are in `label`.

pub(super) mod label;

use std::collections::HashMap;

use super::{
    Store, fault,
    row::{self, Column as _, record},
    sql::{self, QueryBuilder, Transaction},
};
use crate::{
    domain::{
        episode::{Episode, EpisodeFilter, InspectedEpisode},
        id::{BlobId, EpisodeId, TaskId},
    },
    error::{Error, Result},
};

/// Most episodes of one statement. A round trip for each of 10,000 would keep other writers waiting.
pub(super) const BATCH: usize = if cfg!(test) { 2 } else { 500 };

/// The columns of [`Episode`]: everything but the report, which may be long.
macro_rules! episode_columns {
    () => {
        "episodes.id, episodes.task_id, file_name, recording, size_bytes, steps, duration_s, mapping, warnings, \
         episodes.outcome, episodes.cohort, episodes.created_at, deleted_at"
    };
}
pub(super) use episode_columns;

/// The query of these columns; conditions follow.
pub(super) const COLUMNS: &str = concat!("select ", episode_columns!(), " from episodes ");

record! { Episode:
    id, task_id, file_name, recording, size_bytes, steps, duration_s, mapping, warnings, outcome, cohort, created_at,
    deleted_at
}

impl Store {
    /// An episode with its report, also from the trash.
    ///
    /// # Errors
    /// NotFound, also for an episode that is permanently deleted.
    pub(crate) async fn episode(&self, id: &EpisodeId) -> Result<InspectedEpisode> {
        let missing = || Error::not_found("episode", id);
        let mut tx = self.read().begin_read().await.map_err(fault("reading an episode"))?;
        let episode = by_id(&mut tx, id).await?.ok_or_else(missing)?;
        let report = sql::query("select report from episodes where id = $1")
            .bind(id.param())
            .try_map(row::read)
            .fetch_one(&mut tx)
            .await
            .map_err(fault("reading a report"))?;
        Ok(InspectedEpisode { episode, report })
    }

    /// The task and the recording of an episode, also from the trash.
    ///
    /// # Errors
    /// NotFound, also for an episode that is permanently deleted.
    pub(crate) async fn recording_of(&self, id: &EpisodeId) -> Result<(TaskId, BlobId)> {
        sql::query("select task_id, recording from episodes where id = $1 and purged_at is null")
            .bind(id.param())
            .try_map(row::read)
            .fetch_optional(self.read())
            .await
            .map_err(fault("looking for an episode's recording"))?
            .ok_or_else(|| Error::not_found("episode", id))
    }

    /// The task's episode with this recording, if any, also from the trash.
    pub(crate) async fn episode_of(&self, task: &TaskId, recording: &BlobId) -> Result<Option<Episode>> {
        let mut tx = self.read().begin_read().await.map_err(fault("reading an episode"))?;
        by_recording(&mut tx, task, recording).await
    }

    /// At most `size` episodes that match the filter and come after the id `after`, oldest first. The second value is
    /// the `after` of the next page; `None` on the last one.
    pub(crate) async fn episodes(
        &self,
        filter: &EpisodeFilter,
        after: Option<&EpisodeId>,
        size: u32,
    ) -> Result<(Vec<Episode>, Option<EpisodeId>)> {
        let mut query = QueryBuilder::new(COLUMNS);
        query.push("where task_id = ").push_bind(filter.task_id.param());
        query.push(if filter.deleted {
            " and deleted_at is not null and purged_at is null"
        } else {
            " and deleted_at is null"
        });
        if let Some(outcome) = filter.outcome {
            query.push(" and outcome = ").push_bind(outcome.param());
        }
        if let Some(cohort) = &filter.cohort {
            query.push(" and cohort = ").push_bind(cohort);
        }
        if let Some(after) = after {
            query.push(" and id > ").push_bind(after.param());
        }
        // One row more than requested shows whether there is a next page.
        query.push(" order by id limit ").push_bind(i64::from(size) + 1);
        let mut episodes: Vec<Episode> =
            query.build().try_map(row::read).fetch_all(self.read()).await.map_err(fault("listing episodes"))?;
        let size = usize::try_from(size).unwrap_or(usize::MAX);
        let more = episodes.len() > size;
        episodes.truncate(size);
        let next = if more { episodes.last().map(|episode| episode.id.clone()) } else { None };
        Ok((episodes, next))
    }
}

/// An episode that is not permanently deleted.
pub(super) async fn by_id(tx: &mut Transaction, id: &EpisodeId) -> Result<Option<Episode>> {
    let mut query = QueryBuilder::new(COLUMNS);
    query.push("where id = ").push_bind(id.param()).push(" and purged_at is null");
    one(tx, query).await
}

/// Those of these episodes that exist and are not permanently deleted, at most [`BATCH`].
pub(super) async fn by_ids(tx: &mut Transaction, ids: &[&EpisodeId]) -> Result<HashMap<EpisodeId, Episode>> {
    let mut query = QueryBuilder::new(COLUMNS);
    query.push("where purged_at is null and id in (").push_list(ids.iter().map(|id| id.as_str())).push(")");
    let found = query.build().try_map(row::read::<Episode>).fetch_all(&mut *tx).await;
    let found = found.map_err(fault("reading some episodes"))?;
    Ok(found.into_iter().map(|episode| (episode.id.clone(), episode)).collect())
}

/// The task's episode with this recording, if any.
pub(super) async fn by_recording(tx: &mut Transaction, task: &TaskId, recording: &BlobId) -> Result<Option<Episode>> {
    let mut query = QueryBuilder::new(COLUMNS);
    query.push("where task_id = ").push_bind(task.param());
    query.push(" and recording = ").push_bind(recording.param()).push(" and purged_at is null");
    one(tx, query).await
}

async fn one(tx: &mut Transaction, query: QueryBuilder) -> Result<Option<Episode>> {
    query.build().try_map(row::read).fetch_optional(&mut *tx).await.map_err(fault("reading an episode"))
}

/// Makes an episode visible, with its first label. If the task had this recording and it was permanently deleted, the row
/// of that episode is restored instead.
pub(super) async fn insert(tx: &mut Transaction, inspected: &InspectedEpisode, author: &str) -> Result<Episode> {
    let InspectedEpisode { episode, report } = inspected;
    if let Some(revived) = revive(tx, episode).await? {
        label::insert(tx, &revived, author, "pushed again").await?;
        return Ok(revived);
    }
    sql::query(
        "insert into episodes (id, task_id, file_name, recording, size_bytes, steps, duration_s, mapping, warnings, \
             report, outcome, cohort, created_at) values ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11, $12, $13)",
    )
    .bind(episode.id.param())
    .bind(episode.task_id.param())
    .bind(&episode.file_name)
    .bind(episode.recording.param())
    .bind(episode.size_bytes.param())
    .bind(episode.steps.param())
    .bind(episode.duration_s)
    .bind(&episode.mapping)
    .bind(episode.warnings.param())
    .bind(report.param())
    .bind(episode.outcome.param())
    .bind(&episode.cohort)
    .bind(episode.created_at.param())
    .execute(&mut *tx)
    .await
    .map_err(fault("inserting an episode"))?;
    label::insert(tx, episode, author, "").await?;
    Ok(episode.clone())
}

/// Restores the row of an episode whose recording was lost.
async fn revive(tx: &mut Transaction, episode: &Episode) -> Result<Option<Episode>> {
    let revived: Option<EpisodeId> = sql::query(
        "update episodes set purged_at = null, deleted_at = null, delete_forced = false, outcome = $1, cohort = $2 \
         where task_id = $3 and recording = $4 and purged_at is not null returning id",
    )
    .bind(episode.outcome.param())
    .bind(&episode.cohort)
    .bind(episode.task_id.param())
    .bind(episode.recording.param())
    .try_map(row::read)
    .fetch_optional(&mut *tx)
    .await
    .map_err(fault("bringing an episode back"))?;
    match revived {
        Some(id) => by_id(tx, &id).await,
        None => Ok(None),
    }
}

#[cfg(test)]
mod tests;
