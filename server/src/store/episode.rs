//! Rows of episodes; their labels are in `label`.

pub(super) mod label;

use sqlx::{QueryBuilder, Sqlite, Transaction};

use super::{Store, fault, row};
use crate::{
    domain::{
        episode::{Episode, EpisodeFilter, InspectedEpisode, Outcome},
        id::{BlobId, EpisodeId, TaskId},
        time::Millis,
    },
    error::{Error, Result},
};

/// The columns of [`EpisodeRow`]: everything but the report, which may be long.
macro_rules! episode_columns {
    () => {
        "episodes.id, episodes.task_id, file_name, recording, size_bytes, steps, duration_s, mapping, warnings, \
         episodes.outcome, episodes.cohort, episodes.created_at, deleted_at"
    };
}
pub(super) use episode_columns;

/// The query of these columns; conditions follow.
pub(super) const COLUMNS: &str = concat!("select ", episode_columns!(), " from episodes ");

#[derive(sqlx::FromRow)]
pub(super) struct EpisodeRow {
    id: String,
    task_id: String,
    file_name: String,
    recording: String,
    size_bytes: i64,
    steps: i64,
    duration_s: f64,
    mapping: String,
    warnings: i64,
    outcome: String,
    cohort: String,
    created_at: i64,
    deleted_at: Option<i64>,
}

impl EpisodeRow {
    pub(super) fn read(self) -> Result<Episode> {
        Ok(Episode {
            id: row::id("episodes.id", self.id)?,
            task_id: row::id("episodes.task_id", self.task_id)?,
            file_name: self.file_name,
            recording: row::id("episodes.recording", self.recording)?,
            size_bytes: row::count("episodes.size_bytes", self.size_bytes)?,
            steps: row::count("episodes.steps", self.steps)?,
            duration_s: self.duration_s,
            mapping: self.mapping,
            warnings: row::count("episodes.warnings", self.warnings)?,
            outcome: row::parsed("episodes.outcome", Outcome::from_word(&self.outcome))?,
            cohort: self.cohort,
            created_at: Millis(self.created_at),
            deleted_at: self.deleted_at.map(Millis),
        })
    }
}

impl Store {
    /// An episode with its report, also from the trash.
    ///
    /// # Errors
    /// NotFound, also for an episode that is permanently deleted.
    pub(crate) async fn episode(&self, id: &EpisodeId) -> Result<InspectedEpisode> {
        let missing = || Error::not_found("episode", id);
        let mut tx = self.read().begin().await.map_err(fault("reading an episode"))?;
        let episode = by_id(&mut tx, id).await?.ok_or_else(missing)?;
        let report: String = sqlx::query_scalar("select report from episodes where id = ?")
            .bind(id.as_str())
            .fetch_one(&mut *tx)
            .await
            .map_err(fault("reading a report"))?;
        Ok(InspectedEpisode { episode, report: row::json("episodes.report", &report)? })
    }

    /// The task and the recording of an episode, also from the trash.
    ///
    /// # Errors
    /// NotFound, also for an episode that is permanently deleted.
    pub(crate) async fn recording_of(&self, id: &EpisodeId) -> Result<(TaskId, BlobId)> {
        let found: Option<(String, String)> =
            sqlx::query_as("select task_id, recording from episodes where id = ? and purged_at is null")
                .bind(id.as_str())
                .fetch_optional(self.read())
                .await
                .map_err(fault("looking for an episode's recording"))?;
        let (task, recording) = found.ok_or_else(|| Error::not_found("episode", id))?;
        Ok((row::id("episodes.task_id", task)?, row::id("episodes.recording", recording)?))
    }

    /// The task's episode with this recording, if any, also from the trash.
    pub(crate) async fn episode_of(&self, task: &TaskId, recording: &BlobId) -> Result<Option<Episode>> {
        let mut tx = self.read().begin().await.map_err(fault("reading an episode"))?;
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
        let mut query = QueryBuilder::<Sqlite>::new(COLUMNS);
        query.push("where task_id = ").push_bind(filter.task_id.as_str());
        query.push(if filter.deleted {
            " and deleted_at is not null and purged_at is null"
        } else {
            " and deleted_at is null"
        });
        if let Some(outcome) = filter.outcome {
            query.push(" and outcome = ").push_bind(outcome.as_str());
        }
        if let Some(cohort) = &filter.cohort {
            query.push(" and cohort = ").push_bind(cohort);
        }
        if let Some(after) = after {
            query.push(" and id > ").push_bind(after.as_str());
        }
        // One row more than requested shows whether there is a next page.
        query.push(" order by id limit ").push_bind(i64::from(size) + 1);
        let rows: Vec<EpisodeRow> =
            query.build_query_as().fetch_all(self.read()).await.map_err(fault("listing episodes"))?;
        let size = usize::try_from(size).unwrap_or(usize::MAX);
        let more = rows.len() > size;
        let episodes = rows.into_iter().take(size).map(EpisodeRow::read).collect::<Result<Vec<_>>>()?;
        let next = if more { episodes.last().map(|episode| episode.id.clone()) } else { None };
        Ok((episodes, next))
    }
}

/// An episode that is not permanently deleted.
pub(super) async fn by_id(tx: &mut Transaction<'_, Sqlite>, id: &EpisodeId) -> Result<Option<Episode>> {
    let mut query = QueryBuilder::new(COLUMNS);
    query.push("where id = ").push_bind(id.as_str()).push(" and purged_at is null");
    one(tx, query).await
}

/// The task's episode with this recording, if any.
pub(super) async fn by_recording(
    tx: &mut Transaction<'_, Sqlite>,
    task: &TaskId,
    recording: &BlobId,
) -> Result<Option<Episode>> {
    let mut query = QueryBuilder::new(COLUMNS);
    query.push("where task_id = ").push_bind(task.as_str());
    query.push(" and recording = ").push_bind(recording.as_str()).push(" and purged_at is null");
    one(tx, query).await
}

async fn one(tx: &mut Transaction<'_, Sqlite>, mut query: QueryBuilder<Sqlite>) -> Result<Option<Episode>> {
    let row: Option<EpisodeRow> =
        query.build_query_as().fetch_optional(&mut **tx).await.map_err(fault("reading an episode"))?;
    row.map(EpisodeRow::read).transpose()
}

/// Makes an episode visible, with its first label. If the task had this recording and it was permanently deleted, the row
/// of that episode is restored instead.
pub(super) async fn insert(
    tx: &mut Transaction<'_, Sqlite>,
    inspected: &InspectedEpisode,
    author: &str,
) -> Result<Episode> {
    let InspectedEpisode { episode, report } = inspected;
    if let Some(revived) = revive(tx, episode).await? {
        label::insert(tx, &revived, author, "pushed again").await?;
        return Ok(revived);
    }
    sqlx::query(
        "insert into episodes (id, task_id, file_name, recording, size_bytes, steps, duration_s, mapping, warnings, \
             report, outcome, cohort, created_at) values (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
    )
    .bind(episode.id.as_str())
    .bind(episode.task_id.as_str())
    .bind(&episode.file_name)
    .bind(episode.recording.as_str())
    .bind(row::stored(episode.size_bytes))
    .bind(row::stored(episode.steps))
    .bind(episode.duration_s)
    .bind(&episode.mapping)
    .bind(row::stored(episode.warnings))
    .bind(row::to_json(report)?)
    .bind(episode.outcome.as_str())
    .bind(&episode.cohort)
    .bind(episode.created_at.0)
    .execute(&mut **tx)
    .await
    .map_err(fault("inserting an episode"))?;
    label::insert(tx, episode, author, "").await?;
    Ok(episode.clone())
}

/// Restores the row of an episode whose recording was lost.
async fn revive(tx: &mut Transaction<'_, Sqlite>, episode: &Episode) -> Result<Option<Episode>> {
    let revived: Option<String> = sqlx::query_scalar(
        "update episodes set purged_at = null, deleted_at = null, delete_forced = 0, outcome = ?, cohort = ? \
         where task_id = ? and recording = ? and purged_at is not null returning id",
    )
    .bind(episode.outcome.as_str())
    .bind(&episode.cohort)
    .bind(episode.task_id.as_str())
    .bind(episode.recording.as_str())
    .fetch_optional(&mut **tx)
    .await
    .map_err(fault("bringing an episode back"))?;
    match revived {
        Some(id) => by_id(tx, &row::id("episodes.id", id)?).await,
        None => Ok(None),
    }
}

#[cfg(test)]
mod tests;
