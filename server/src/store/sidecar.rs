//! Rows whose sidecars are missing or out of date, and rows restored from sidecars.

use super::{
    Store, episode, fault,
    row::{self, Column as _, record},
    sql::{self, QueryBuilder},
};
use crate::{
    domain::{
        description::{Description, Recording},
        episode::InspectedEpisode,
        id::{BlobId, EpisodeId, PolicyId, TaskId},
        task::Task,
        time::Millis,
    },
    error::{Error, Kind, Result},
};

record! { Undescribed: seq, id }

/// A row to be described.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Undescribed {
    seq: i64,
    /// The id of a task, an episode, an encoder or a policy.
    pub(crate) id: String,
}

/// The sidecar of one row.
#[derive(Debug)]
pub(crate) enum Described {
    /// Beside the blob.
    Beside(BlobId, Description),
    /// Among the tasks.
    Task(Description),
    /// The row is gone, or its recording.
    Gone,
}

impl Store {
    /// Up to `most` rows whose sidecars are out of date, oldest changes first, after `after`.
    pub(crate) async fn undescribed(&self, after: Option<&Undescribed>, most: u32) -> Result<Vec<Undescribed>> {
        sql::query("select seq, id from sidecar_queue where seq > $1 order by seq limit $2")
            .bind(after.map_or(0, |row| row.seq))
            .bind(most)
            .try_map(row::read)
            .fetch_all(self.read())
            .await
            .map_err(fault("listing rows without a sidecar"))
    }

    /// The episodes with existing recordings, each with its recording.
    pub(crate) async fn kept_recordings(&self) -> Result<Vec<(EpisodeId, BlobId)>> {
        sql::query("select id, recording from episodes where purged_at is null")
            .try_map(row::read)
            .fetch_all(self.read())
            .await
            .map_err(fault("listing recordings"))
    }

    /// Queues the sidecars of these episodes to be written again.
    pub(crate) async fn queue_sidecars(&self, ids: &[EpisodeId]) -> Result<()> {
        let mut tx = self.write().await?;
        // After a restore these are all episodes.
        for part in ids.chunks(episode::BATCH) {
            // At the end of the queue, also if they are there already.
            let mut delete = QueryBuilder::new("delete from sidecar_queue where id in (");
            delete.push_list(part.iter().map(EpisodeId::as_str)).push(")");
            let mut insert = QueryBuilder::new("insert into sidecar_queue (id) values ");
            for (place, id) in part.iter().enumerate() {
                insert.push(if place == 0 { "(" } else { ", (" }).push_bind(id.as_str()).push(")");
            }
            for query in [delete, insert] {
                query.build().execute(&mut tx).await.map_err(fault("queueing sidecars"))?;
            }
        }
        self.commit(tx).await
    }

    /// Accepts the existing sidecars unchanged, until a row changes.
    pub(crate) async fn forget_queued_sidecars(&self) -> Result<()> {
        let mut tx = self.write().await?;
        sql::query("delete from sidecar_queue").execute(&mut tx).await.map_err(fault("keeping the sidecars"))?;
        self.commit(tx).await
    }

    /// Removes rows from the queue: their sidecars are on disk with the content that the rows had when they were
    /// listed.
    pub(crate) async fn note_described(&self, rows: &[Undescribed]) -> Result<()> {
        let mut tx = self.write().await?;
        for row in rows {
            sql::query("delete from sidecar_queue where seq = $1")
                .bind(row.seq)
                .execute(&mut tx)
                .await
                .map_err(fault("noting a sidecar"))?;
        }
        self.commit(tx).await
    }

    /// The description of a row.
    pub(crate) async fn description(&self, id: &str) -> Result<Described> {
        let described = if let Ok(id) = EpisodeId::try_from(id.to_owned()) {
            self.episode_description(&id).await
        } else if let Ok(id) = TaskId::try_from(id.to_owned()) {
            self.task_by_id(&id).await.map(|task| Described::Task(Description::task(&task)))
        } else if let Ok(id) = id.to_owned().try_into() {
            self.encoder(&id).await.map(|encoder| {
                let (task_id, job_id) = (encoder.task_id, encoder.job_id);
                let created_at = encoder.created_at;
                Described::Beside(encoder.checkpoint, Description::Encoder { id, task_id, job_id, created_at })
            })
        } else {
            let id = PolicyId::try_from(id.to_owned());
            let id = id.map_err(|problem| Error::internal("reading the id of a queued sidecar", problem))?;
            self.policy(&id).await.map(|policy| {
                // A policy of another server has no blob here.
                let Some(training) = policy.training().cloned() else { return Described::Gone };
                let (task_id, job_id, created_at) = (policy.task_id, training.job_id, policy.created_at);
                let description = Description::Policy { id, task_id, job_id, policy: policy.kind, created_at };
                Described::Beside(training.checkpoint, description)
            })
        };
        match described {
            Err(error) if error.kind() == Kind::NotFound => Ok(Described::Gone),
            described => described,
        }
    }

    async fn episode_description(&self, id: &EpisodeId) -> Result<Described> {
        let inspected = self.episode(id).await?;
        let labels = self.labels(id).await?;
        let author = labels.last().map(|label| label.author.clone()).unwrap_or_default();
        let recording = inspected.episode.recording.clone();
        Ok(Described::Beside(recording, Description::recording(&inspected, &author)))
    }

    /// Restores the row of a task, and returns the task that its episodes belong to and whether it was created. If
    /// another task has the name, that one is returned if its spec is equal; otherwise the restored task is named by
    /// its id.
    pub(crate) async fn restore_task(&self, task: &Task) -> Result<(TaskId, bool)> {
        if self.task_by_id(&task.id).await.is_ok() {
            return Ok((task.id.clone(), false));
        }
        let mut spec = task.spec.clone();
        match self.task(&spec.name).await {
            Ok(same) if same.spec == spec => return Ok((same.id, false)),
            Ok(_) => task.id.as_str().clone_into(&mut spec.name),
            Err(error) if error.kind() == Kind::NotFound => {}
            Err(error) => return Err(error),
        }
        let mut tx = self.write().await?;
        sql::query("insert into tasks (id, name, spec, created_at) values ($1, $2, $3, $4)")
            .bind(task.id.param())
            .bind(&spec.name)
            .bind(spec.param())
            .bind(task.created_at.param())
            .execute(&mut tx)
            .await
            .map_err(fault("restoring a task"))?;
        self.commit(tx).await?;
        Ok((task.id.clone(), true))
    }

    /// Updates an episode's label and its presence in the trash from its sidecar; true when either differed.
    pub(crate) async fn update_episode(&self, described: &Recording) -> Result<bool> {
        let mut tx = self.write().await?;
        let Some(mut episode) = episode::by_id(&mut tx, &described.episode.id).await? else { return Ok(false) };
        let labelled = (episode.outcome, &episode.cohort) != (described.episode.outcome, &described.episode.cohort);
        let trashed = episode.deleted_at.is_some() != described.episode.deleted_at.is_some();
        if !labelled && !trashed {
            return Ok(false);
        }
        (episode.outcome, episode.cohort) = (described.episode.outcome, described.episode.cohort.clone());
        // The retention time in the trash starts again.
        let deleted_at = described.episode.deleted_at.map(|_| Millis::now());
        sql::query(
            "update episodes set outcome = $1, cohort = $2, deleted_at = $3, delete_forced = false where id = $4",
        )
        .bind(episode.outcome.param())
        .bind(&episode.cohort)
        .bind(if trashed { deleted_at } else { episode.deleted_at }.param())
        .bind(episode.id.param())
        .execute(&mut tx)
        .await
        .map_err(fault("bringing an episode up to date"))?;
        if labelled {
            episode::label::insert(&mut tx, &episode, &described.author, "rebuilt from its sidecar").await?;
        }
        self.commit(tx).await?;
        Ok(true)
    }

    /// Restores the row of an episode, with its present label as its first one; false when the database has the row, or
    /// its task has the recording as another episode.
    ///
    /// # Errors
    /// NotFound when its task does not exist.
    pub(crate) async fn restore_episode(&self, described: Recording) -> Result<bool> {
        self.task_by_id(&described.episode.task_id).await?;
        let mut tx = self.write().await?;
        let known: bool = row::query_as(
            "select exists (select 1 from episodes where purged_at is null \
             and (id = $1 or (task_id = $2 and recording = $3)))",
        )
        .bind(described.episode.id.param())
        .bind(described.episode.task_id.param())
        .bind(described.episode.recording.param())
        .fetch_one(&mut tx)
        .await
        .map_err(fault("looking for an episode"))?;
        if known {
            return Ok(false);
        }
        let (author, deleted_at) = (described.author.clone(), described.episode.deleted_at);
        let Recording { episode, author: _, report } = described;
        let inspected = InspectedEpisode { episode, report };
        episode::insert(&mut tx, &inspected, &author).await?;
        if let Some(deleted_at) = deleted_at {
            // The retention time in the trash starts again, because the time spent there is unknown.
            sql::query("update episodes set deleted_at = $1 where id = $2")
                .bind(deleted_at.max(Millis::now()).param())
                .bind(inspected.episode.id.param())
                .execute(&mut tx)
                .await
                .map_err(fault("making an episode again"))?;
        }
        self.commit(tx).await?;
        Ok(true)
    }
}

#[cfg(test)]
mod tests;
