//! Deleted episodes: moved into the trash, restored from it, and permanently removed.

use std::collections::HashSet;

use super::{
    Store, episode, fault,
    row::{self, Column as _},
    sql::{self, QueryBuilder, Transaction},
};
use crate::{
    domain::{
        episode::Episode,
        id::{BlobId, EpisodeId, SnapshotId},
        time::Millis,
    },
    error::{Error, Result},
};

/// Most episodes that one write removes.
const BATCH: u32 = if cfg!(test) { 2 } else { 1000 };

/// The first episodes that were moved to the trash before a time and that nothing needs.
macro_rules! unneeded {
    () => {
        "select id from episodes where deleted_at < $1 \
         and not exists (select 1 from snapshot_episodes where episode_id = episodes.id) \
         and not exists (select 1 from episode_scores where episode_id = episodes.id) order by id limit $2"
    };
}

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
        for part in ids.chunks(episode::BATCH) {
            let missing = |id: &EpisodeId| Error::not_found("episode", format!("{id}; no episode was deleted"));
            all_of(&mut tx, part, missing).await?;
            if !force {
                refuse_if_one_is_needed(&mut tx, part).await?;
            }
            let mut query = QueryBuilder::new("update episodes set deleted_at = coalesce(deleted_at, ");
            query.push_bind(Millis::now().param()).push("), delete_forced = delete_forced or ").push_bind(force);
            query.push(" where id in (").push_list(part.iter().map(EpisodeId::as_str)).push(")");
            query.build().execute(&mut tx).await.map_err(fault("deleting episodes"))?;
            deleted.extend(all_of(&mut tx, part, missing).await?);
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
        for part in ids.chunks(episode::BATCH) {
            let mut query = QueryBuilder::new(
                "update episodes set deleted_at = null, delete_forced = false where purged_at is null and id in (",
            );
            query.push_list(part.iter().map(EpisodeId::as_str)).push(")");
            query.build().execute(&mut tx).await.map_err(fault("taking episodes back"))?;
            let missing = |id: &EpisodeId| {
                Error::not_found("episode", format!("{id}: unknown, or permanently deleted; no episode was restored"))
            };
            back.extend(all_of(&mut tx, part, missing).await?);
        }
        self.commit_generation(tx).await?;
        Ok(back)
    }

    /// Permanently removes the episodes that were moved to the trash before `time`. An episode in a snapshot keeps its
    /// row, and is removed only if it was deleted by force and no job of its task is running.
    ///
    /// Some at a time, so that other writers wait for a part of a large trash only.
    pub(crate) async fn sweep_trash(&self, time: Millis) -> Result<Swept> {
        let mut swept = Swept::default();
        while self.sweep_some(time, &mut swept).await? {}
        Ok(swept)
    }

    /// Removes up to [`BATCH`] episodes; returns whether there may be more.
    async fn sweep_some(&self, time: Millis, swept: &mut Swept) -> Result<bool> {
        let mut tx = self.write().await?;
        sql::query(concat!("delete from labels where episode_id in (", unneeded!(), ")"))
            .bind(time.param())
            .bind(BATCH)
            .execute(&mut tx)
            .await
            .map_err(fault("emptying the trash"))?;
        let removed: Vec<(EpisodeId, BlobId)> =
            sql::query(concat!("delete from episodes where id in (", unneeded!(), ") returning id, recording"))
                .bind(time.param())
                .bind(BATCH)
                .try_map(row::read)
                .fetch_all(&mut tx)
                .await
                .map_err(fault("emptying the trash"))?;
        // The newest labels may have been removed, and their numbers are used again.
        for query in [
            "update schedules set label_mark = (select coalesce(max(id), 0) from labels) \
             where label_mark > (select coalesce(max(id), 0) from labels)",
            "update snapshots set label_mark = (select coalesce(max(id), 0) from labels) \
             where label_mark > (select coalesce(max(id), 0) from labels)",
        ] {
            sql::query(query).execute(&mut tx).await.map_err(fault("emptying the trash"))?;
        }
        let more = removed.len() as u64 == u64::from(BATCH);
        // After the last ones that need no row.
        let purged = if more { Vec::new() } else { purge(&mut tx, time).await? };
        crate::fail_point::pass("sweep.rows_removed");
        self.commit(tx).await?;
        crate::fail_point::pass("sweep.committed");
        swept.removed += removed.len() as u64;
        swept.purged += purged.len() as u64;
        swept.episodes.extend(removed.into_iter().chain(purged));
        Ok(more)
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

/// These episodes, in their order.
async fn all_of(
    tx: &mut Transaction,
    ids: &[EpisodeId],
    missing: impl Fn(&EpisodeId) -> Error,
) -> Result<Vec<Episode>> {
    let found = episode::by_ids(tx, &ids.iter().collect::<Vec<_>>()).await?;
    ids.iter().map(|id| found.get(id).cloned().ok_or_else(|| missing(id))).collect()
}

/// Rejects these episodes if a snapshot contains one, and names the first.
async fn refuse_if_one_is_needed(tx: &mut Transaction, ids: &[EpisodeId]) -> Result<()> {
    let mut query = QueryBuilder::new("select id from episodes where id in (");
    query.push_list(ids.iter().map(EpisodeId::as_str));
    query.push(") and exists (select 1 from snapshot_episodes where episode_id = episodes.id)");
    let needed: HashSet<EpisodeId> = query
        .build()
        .try_map(row::read)
        .fetch_all(&mut *tx)
        .await
        .map_err(fault("looking for the snapshots of episodes"))?
        .into_iter()
        .collect();
    match ids.iter().find(|id| needed.contains(id)) {
        Some(first) => refuse_if_needed(tx, first).await,
        None => Ok(()),
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

/// Marks the episodes whose recordings are removed while snapshots keep their rows.
async fn purge(tx: &mut Transaction, time: Millis) -> Result<Vec<(EpisodeId, BlobId)>> {
    sql::query(
        "update episodes set purged_at = $1 where deleted_at < $2 and delete_forced and purged_at is null \
         and not exists (select 1 from jobs where jobs.task_id = episodes.task_id and state in ('queued', 'running')) \
         returning id, recording",
    )
    .bind(Millis::now().param())
    .bind(time.param())
    .try_map(row::read)
    .fetch_all(&mut *tx)
    .await
    .map_err(fault("emptying the trash"))
}

#[cfg(test)]
mod tests;
