//! Rows of episodes and of their labels.

use std::collections::HashSet;

use sqlx::{QueryBuilder, Sqlite, Transaction};

use super::{Store, commit, fault, row};
use crate::{
    domain::{
        episode::{Episode, EpisodeFilter, InspectedEpisode, Label, NewLabel, Outcome},
        id::{BlobId, EpisodeId, TaskId},
        time::Millis,
    },
    error::{Error, Result},
};

/// The columns of [`EpisodeRow`]: everything but the report, which may be long.
pub(super) const COLUMNS: &str = "select episodes.id, episodes.task_id, file_name, recording, size_bytes, steps, \
     duration_s, mapping, warnings, episodes.outcome, episodes.cohort, episodes.created_at, \
     deleted_at from episodes ";

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
    /// An episode with its report, though it be in the trash.
    ///
    /// # Errors
    /// NotFound; so is one that is gone for good.
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

    /// The task's episode with this very recording, if any, though it be in the trash.
    pub(crate) async fn episode_of(&self, task: &TaskId, recording: &BlobId) -> Result<Option<Episode>> {
        let mut tx = self.read().begin().await.map_err(fault("reading an episode"))?;
        by_recording(&mut tx, task, recording).await
    }

    /// At most `size` episodes that fit the filter and come after the id `after`, oldest first. The second
    /// value is where the next page goes on; `None` on the last one.
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
        // One more than asked tells whether there is a next page.
        query.push(" order by id limit ").push_bind(i64::from(size) + 1);
        let rows: Vec<EpisodeRow> =
            query.build_query_as().fetch_all(self.read()).await.map_err(fault("listing episodes"))?;
        let size = usize::try_from(size).unwrap_or(usize::MAX);
        let more = rows.len() > size;
        let episodes = rows.into_iter().take(size).map(EpisodeRow::read).collect::<Result<Vec<_>>>()?;
        let next = if more { episodes.last().map(|episode| episode.id.clone()) } else { None };
        Ok((episodes, next))
    }

    /// Labels all these episodes or, when one is unknown, none. Every change is kept. The answer is in the
    /// order of `ids`; one that is named twice is labelled once.
    ///
    /// # Errors
    /// NotFound names the first unknown episode; Precondition the first that is in the trash.
    pub(crate) async fn label_episodes(&self, ids: &[EpisodeId], label: &NewLabel) -> Result<Vec<Episode>> {
        let mut tx = self.write().await?;
        let mut labelled: Vec<Episode> = Vec::with_capacity(ids.len());
        let mut seen = HashSet::new();
        for id in ids.iter().filter(|id| seen.insert(*id)) {
            let mut episode = by_id(&mut tx, id)
                .await?
                .ok_or_else(|| Error::not_found("episode", format!("{id}; nothing was labelled")))?;
            if episode.deleted_at.is_some() {
                return Err(Error::precondition(format!(
                    "{id} is in the trash; nothing was labelled. Take it back first"
                )));
            }
            episode.outcome = label.outcome;
            if let Some(cohort) = &label.cohort {
                episode.cohort.clone_from(cohort);
            }
            sqlx::query("update episodes set outcome = ?, cohort = ? where id = ?")
                .bind(episode.outcome.as_str())
                .bind(&episode.cohort)
                .bind(id.as_str())
                .execute(&mut *tx)
                .await
                .map_err(fault("labelling an episode"))?;
            insert_label(&mut tx, &episode, &label.author, &label.reason).await?;
            labelled.push(episode);
        }
        crate::fail_point::pass("label.rows_written");
        commit(tx).await?;
        crate::fail_point::pass("label.committed");
        Ok(labelled)
    }

    /// Every label an episode ever had, oldest first.
    ///
    /// # Errors
    /// NotFound.
    pub(crate) async fn labels(&self, id: &EpisodeId) -> Result<Vec<Label>> {
        let rows = sqlx::query_as::<_, (String, String, String, String, i64)>(
            "select outcome, cohort, author, reason, created_at from labels where episode_id = ? order by id",
        )
        .bind(id.as_str())
        .fetch_all(self.read())
        .await
        .map_err(fault("listing labels"))?;
        if rows.is_empty() {
            // An episode has a label from its first moment on.
            return Err(Error::not_found("episode", id));
        }
        rows.into_iter()
            .map(|(outcome, cohort, author, reason, created_at)| {
                Ok(Label {
                    outcome: row::parsed("labels.outcome", Outcome::from_word(&outcome))?,
                    cohort,
                    author,
                    reason,
                    created_at: Millis(created_at),
                })
            })
            .collect()
    }
}

/// An episode that is not gone for good.
pub(super) async fn by_id(tx: &mut Transaction<'_, Sqlite>, id: &EpisodeId) -> Result<Option<Episode>> {
    let mut query = QueryBuilder::new(COLUMNS);
    query.push("where id = ").push_bind(id.as_str()).push(" and purged_at is null");
    one(tx, query).await
}

/// The task's episode with this very recording, if any.
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

/// Makes an episode visible, with its first label. When the task had this recording and lost it for good, it is that
/// episode again.
pub(super) async fn insert(
    tx: &mut Transaction<'_, Sqlite>,
    inspected: &InspectedEpisode,
    author: &str,
) -> Result<Episode> {
    let InspectedEpisode { episode, report } = inspected;
    if let Some(revived) = revive(tx, episode).await? {
        insert_label(tx, &revived, author, "pushed again").await?;
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
    insert_label(tx, episode, author, "").await?;
    Ok(episode.clone())
}

/// Brings back the row of an episode whose recording was gone.
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

/// Keeps the episode's present label in its history.
async fn insert_label(tx: &mut Transaction<'_, Sqlite>, episode: &Episode, author: &str, reason: &str) -> Result<()> {
    sqlx::query(
        "insert into labels (episode_id, outcome, cohort, author, reason, created_at) values (?, ?, ?, ?, ?, ?)",
    )
    .bind(episode.id.as_str())
    .bind(episode.outcome.as_str())
    .bind(&episode.cohort)
    .bind(author)
    .bind(reason)
    .bind(Millis::now().0)
    .execute(&mut **tx)
    .await
    .map_err(fault("keeping a label"))?;
    Ok(())
}

#[cfg(test)]
mod tests;
