//! Deleted episodes: moved into the trash, restored from it, and permanently removed.

use super::{
    Store, episode, fault,
    row::{self, Column as _},
    sql::{self, Transaction},
};
use crate::{
    domain::{
        episode::Episode,
        id::{BlobId, EpisodeId, SnapshotId},
        time::Millis,
    },
    error::{Error, Result},
};

/// The counts of a sweep of the trash.
#[derive(Debug, Default)]
pub(crate) struct Swept {
    /// Episodes that are removed with their rows.
    pub(crate) removed: u64,
    /// Episodes whose recordings are removed; snapshots keep their rows.
    pub(crate) purged: u64,
    /// Their ids and recordings, which no other row may need any more.
    pub(crate) episodes: Vec<(EpisodeId, BlobId)>,
}

impl Store {
    /// Moves all these episodes to the trash, or none if one of them must stay. The result is in the order of `ids`. An
    /// episode already in the trash keeps its date.
    ///
    /// # Errors
    /// NotFound names the first unknown episode; Precondition the first that a snapshot contains, unless `force`.
    pub(crate) async fn delete_episodes(&self, ids: &[EpisodeId], force: bool) -> Result<Vec<Episode>> {
        let mut tx = self.write().await?;
        let mut deleted = Vec::with_capacity(ids.len());
        for id in ids {
            let before = episode::by_id(&mut tx, id).await?;
            let before = before.ok_or_else(|| Error::not_found("episode", format!("{id}; no episode was deleted")))?;
            if !force {
                refuse_if_needed(&mut tx, id).await?;
            }
            sql::query(
                "update episodes set deleted_at = coalesce(deleted_at, $1), delete_forced = delete_forced or $2 \
                 where id = $3",
            )
            .bind(Millis::now().param())
            .bind(force)
            .bind(id.param())
            .execute(&mut tx)
            .await
            .map_err(fault("deleting an episode"))?;
            deleted.push(episode::by_id(&mut tx, id).await?.unwrap_or(before));
        }
        self.commit_generation(tx).await?;
        Ok(deleted)
    }

    /// Takes all these episodes out of the trash, or none. An episode outside the trash is left unchanged.
    ///
    /// # Errors
    /// NotFound names the first that is unknown or permanently deleted.
    pub(crate) async fn undelete_episodes(&self, ids: &[EpisodeId]) -> Result<Vec<Episode>> {
        let mut tx = self.write().await?;
        let mut back = Vec::with_capacity(ids.len());
        for id in ids {
            sql::query(
                "update episodes set deleted_at = null, delete_forced = false where id = $1 and purged_at is null",
            )
            .bind(id.param())
            .execute(&mut tx)
            .await
            .map_err(fault("taking an episode back"))?;
            let episode = episode::by_id(&mut tx, id).await?;
            back.push(episode.ok_or_else(|| {
                Error::not_found("episode", format!("{id}: unknown, or permanently deleted; no episode was restored"))
            })?);
        }
        self.commit_generation(tx).await?;
        Ok(back)
    }

    /// Permanently removes the episodes that were moved to the trash before `time`. An episode in a snapshot keeps its
    /// row, and is removed only if it was deleted by force and no job of its task is running.
    pub(crate) async fn sweep_trash(&self, time: Millis) -> Result<Swept> {
        let mut tx = self.write().await?;
        let mut episodes: Vec<(EpisodeId, BlobId)> = sql::query(
            "select id, recording from episodes where deleted_at < $1 \
             and not exists (select 1 from snapshot_episodes where episode_id = episodes.id) \
             and not exists (select 1 from episode_scores where episode_id = episodes.id)",
        )
        .bind(time.param())
        .try_map(row::read)
        .fetch_all(&mut tx)
        .await
        .map_err(fault("looking through the trash"))?;
        for (id, _) in &episodes {
            for query in ["delete from labels where episode_id = $1", "delete from episodes where id = $1"] {
                sql::query(query).bind(id.param()).execute(&mut tx).await.map_err(fault("emptying the trash"))?;
            }
        }
        // The newest labels may have been removed, and their numbers are used again.
        for query in [
            "update schedules set label_mark = (select coalesce(max(id), 0) from labels) \
             where label_mark > (select coalesce(max(id), 0) from labels)",
            "update snapshots set label_mark = (select coalesce(max(id), 0) from labels) \
             where label_mark > (select coalesce(max(id), 0) from labels)",
        ] {
            sql::query(query).execute(&mut tx).await.map_err(fault("emptying the trash"))?;
        }
        let purged = sql::query(
            "update episodes set purged_at = $1 where deleted_at < $2 and delete_forced and purged_at is null \
             and not exists (select 1 from jobs where jobs.task_id = episodes.task_id and state in ('queued', 'running')) \
             returning id, recording",
        )
        .bind(Millis::now().param())
        .bind(time.param())
        .try_map(row::read)
        .fetch_all(&mut tx)
        .await
        .map_err(fault("emptying the trash"))?;
        crate::fail_point::pass("sweep.rows_removed");
        self.commit(tx).await?;
        crate::fail_point::pass("sweep.committed");
        let (removed, purged_count) = (episodes.len() as u64, purged.len() as u64);
        episodes.extend(purged);
        Ok(Swept { removed, purged: purged_count, episodes })
    }

    /// Rejects a snapshot with a removed recording: it can no longer be trained on.
    ///
    /// # Errors
    /// Precondition.
    pub(crate) async fn expect_recordings(&self, snapshot: &SnapshotId) -> Result<()> {
        let gone: Option<EpisodeId> = sql::query(
            "select id from episodes join snapshot_episodes on episode_id = id \
             where snapshot_id = $1 and purged_at is not null order by id limit 1",
        )
        .bind(snapshot.param())
        .try_map(row::read)
        .fetch_optional(self.read())
        .await
        .map_err(fault("reading the deleted episodes of a snapshot"))?;
        match gone {
            None => Ok(()),
            Some(episode) => Err(Error::precondition(format!(
                "the recording of {episode}, which {snapshot} holds, was permanently deleted: create a new snapshot, \
                 or push the recording again"
            ))),
        }
    }

    /// When the longest running attempt began; its results may not have rows yet.
    pub(crate) async fn oldest_running(&self) -> Result<Option<Millis>> {
        sql::query("select min(started_at) from jobs where state = 'running'")
            .try_map(row::read)
            .fetch_one(self.read())
            .await
            .map_err(fault("reading the running jobs"))
    }
}

/// Rejects the deletion when snapshots or results need the episode, and names them.
async fn refuse_if_needed(tx: &mut Transaction, id: &EpisodeId) -> Result<()> {
    let (snapshots, first): (u64, Option<SnapshotId>) =
        sql::query("select count(*), min(snapshot_id) from snapshot_episodes where episode_id = $1")
            .bind(id.param())
            .try_map(row::read)
            .fetch_one(&mut *tx)
            .await
            .map_err(fault("reading the snapshots of an episode"))?;
    let Some(first) = first else { return Ok(()) };
    let (runs, datasets, policies): (u64, u64, u64) = sql::query(
        "with held(id) as (select snapshot_id from snapshot_episodes where episode_id = $1), \
         runs(id) as (select id from score_runs where snapshot_id in (select id from held)), \
         sets(id) as (select id from datasets where score_run_id in (select id from runs)) \
         select (select count(*) from runs), (select count(*) from sets), \
         (select count(*) from policies join jobs on jobs.id = job_id where dataset_id in (select id from sets) \
          or json_extract(jobs.spec, '$.snapshot_id') in (select id from held))",
    )
    .bind(id.param())
    .try_map(row::read)
    .fetch_one(&mut *tx)
    .await
    .map_err(fault("reading the results made from an episode"))?;
    let others = if snapshots > 1 { format!(" and {} more snapshots", snapshots - 1) } else { String::new() };
    Err(Error::precondition(format!(
        "{id} is in {first}{others}, used by {runs} score runs, {datasets} datasets and {policies} policies. Repeat with \
         force to delete it; these results can then not be reproduced"
    )))
}

#[cfg(test)]
mod tests;
