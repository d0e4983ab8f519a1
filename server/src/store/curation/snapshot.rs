//! Snapshots and their episodes, in both directions.

use crate::{
    domain::{
        curation::{FrozenEpisode, LabelSeen, SnapshotChanges, SnapshotUse, Standing},
        id::{EpisodeId, SnapshotId},
    },
    error::Result,
    store::{
        Store, fault,
        row::{self, Column as _, Record, column, record},
        sql::{self, Row},
    },
};

record! { SnapshotChanges: relabelled, deleted }
record! { SnapshotUse: snapshot_id, created_at, role, outcome, cohort }

impl Record for FrozenEpisode {
    fn decode(row: &Row) -> sqlx::Result<Self> {
        let label = |outcome, cohort, version| -> sqlx::Result<_> {
            let (outcome, cohort) = (column(row, outcome)?, column(row, cohort)?);
            Ok(LabelSeen { outcome, cohort, version: column(row, version)? })
        };
        Ok(Self {
            episode_id: column(row, "episode_id")?,
            file_name: column(row, "file_name")?,
            role: column(row, "role")?,
            then: label("outcome", "cohort", "version")?,
            now: label("outcome_now", "cohort_now", "version_now")?,
            standing: match (column(row, "purged")?, column(row, "in_trash")?) {
                (true, _) => Standing::Deleted,
                (false, true) => Standing::InTrash,
                (false, false) => Standing::Present,
            },
        })
    }
}

/// The changes of a snapshot's episodes. Only episodes with a label that is newer than the snapshot are compared, and only
/// permanently deleted ones are looked up: in most snapshots few of 100,000. `cross join` fixes that order.
const CHANGES: &str = "select \
     (select count(distinct held.episode_id) from labels cross join snapshot_episodes held cross join episodes \
         where held.snapshot_id = $1 and held.episode_id = labels.episode_id and episodes.id = held.episode_id \
             and labels.id > (select label_mark from snapshots where id = $1) \
             and (held.outcome, held.cohort) <> (episodes.outcome, episodes.cohort)) as relabelled, \
     (select count(*) from episodes cross join snapshot_episodes held \
         where held.snapshot_id = $1 and held.episode_id = episodes.id and purged_at is not null) as deleted";

impl Store {
    /// The first episodes of a snapshot in its order, or all, with their labels then and now; no episode for an unknown
    /// snapshot.
    ///
    /// A snapshot stores labels, not their versions: the version is that of the newest equal label that is not younger
    /// than the snapshot.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn frozen_episodes(&self, id: &SnapshotId, most: Option<u32>) -> Result<Vec<FrozenEpisode>> {
        sql::query(
            "select held.episode_id, file_name, role, held.outcome, held.cohort, episodes.outcome as outcome_now, \
                 episodes.cohort as cohort_now, deleted_at is not null as in_trash, purged_at is not null as purged, \
                 (select max(labels.id) from labels where labels.episode_id = held.episode_id \
                      and labels.outcome = held.outcome and labels.cohort = held.cohort \
                      and labels.created_at <= snapshots.created_at) as version, \
                 (select max(labels.id) from labels where labels.episode_id = held.episode_id) as version_now \
             from snapshot_episodes held join snapshots on snapshots.id = held.snapshot_id \
                 join episodes on episodes.id = held.episode_id \
             where held.snapshot_id = $1 order by held.position limit $2",
        )
        .bind(id.param())
        .bind(most.map_or(i64::MAX, i64::from))
        .try_map(row::read)
        .fetch_all(self.read())
        .await
        .map_err(fault("reading a snapshot's episodes and their labels"))
    }

    /// The number of a snapshot's episodes that have another label now, and of those whose recording is gone.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn snapshot_changes(&self, id: &SnapshotId) -> Result<SnapshotChanges> {
        sql::query(CHANGES)
            .bind(id.param())
            .try_map(row::read)
            .fetch_one(self.read())
            .await
            .map_err(fault("counting the changes of a snapshot's episodes"))
    }

    /// At most `most` snapshots that contain an episode, newest first, and the number of all of them.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn snapshots_with(&self, episode: &EpisodeId, most: u32) -> Result<(Vec<SnapshotUse>, u64)> {
        let mut of = 0;
        let uses = sql::query(
            "select snapshot_id, created_at, role, outcome, cohort, count(*) over () as \"of\" \
             from snapshot_episodes join snapshots on snapshots.id = snapshot_id \
             where episode_id = $1 order by created_at desc, snapshot_id desc limit $2",
        )
        .bind(episode.param())
        .bind(most)
        .try_map(|row| {
            of = column(&row, "of")?;
            SnapshotUse::decode(&row)
        })
        .fetch_all(self.read())
        .await
        .map_err(fault("reading the snapshots of an episode"))?;
        Ok((uses, of))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        domain::{
            episode::{NewLabel, Outcome},
            snapshot::{Role, RoleRule},
            time::Millis,
        },
        store::testing,
    };

    fn label(outcome: Outcome) -> NewLabel {
        NewLabel { outcome: Some(outcome), cohort: None, author: "ada".into(), reason: String::new() }
    }

    #[tokio::test]
    async fn a_snapshot_lists_labels_then_and_now_and_removed_episodes() {
        let (_dir, store) = testing::store().await;
        let task = testing::task(&store).await;
        let expert = testing::episode(&store, &task, Outcome::Success, "").await.id;
        let failure = testing::episode(&store, &task, Outcome::Failure, "bob").await.id;
        // An equal label has another version.
        store.label_episodes(std::slice::from_ref(&failure), &label(Outcome::Failure)).await.unwrap();
        let version = store.label_version(&failure).await.unwrap();
        let id = store.create_snapshot(&task.id, &RoleRule::default()).await.unwrap().id;
        store.label_episodes(std::slice::from_ref(&failure), &label(Outcome::Success)).await.unwrap();
        store.delete_episodes(std::slice::from_ref(&expert), true).await.unwrap();

        let of = async |episode: &EpisodeId| {
            let held = store.frozen_episodes(&id, None).await.unwrap();
            held.into_iter().find(|held| held.episode_id == *episode).unwrap()
        };
        let held = of(&failure).await;
        let then = LabelSeen { outcome: Outcome::Failure, cohort: "bob".into(), version: Some(version) };
        assert_eq!((held.role, held.then, held.standing), (Role::Imperfect, then, Standing::Present));
        assert_eq!((held.now.outcome, held.now.version.is_some_and(|now| now > version)), (Outcome::Success, true));
        let held = of(&expert).await;
        assert_eq!((held.relabelled(), held.standing), (false, Standing::InTrash));
        store.sweep_trash(Millis(i64::MAX)).await.unwrap();
        assert_eq!(of(&expert).await.standing, Standing::Deleted);
        assert_eq!(store.snapshot_changes(&id).await.unwrap(), SnapshotChanges { relabelled: 1, deleted: 1 });
        assert_eq!(store.frozen_episodes(&id, Some(1)).await.unwrap().len(), 1);
        assert!(store.frozen_episodes(&SnapshotId::new(), None).await.unwrap().is_empty());
    }

    /// Labels are removed with the episodes of no snapshot, and their numbers are used again.
    #[tokio::test]
    async fn a_label_is_newer_than_the_snapshot_after_the_trash_is_emptied_too() {
        let (_dir, store) = testing::store().await;
        let task = testing::task(&store).await;
        testing::episode(&store, &task, Outcome::Success, "").await;
        let failure = testing::episode(&store, &task, Outcome::Failure, "").await.id;
        let left_out = testing::episode(&store, &task, Outcome::Unknown, "").await.id;
        store.label_episodes(std::slice::from_ref(&left_out), &label(Outcome::Unknown)).await.unwrap();
        let id = store.create_snapshot(&task.id, &RoleRule::default()).await.unwrap().id;
        store.delete_episodes(std::slice::from_ref(&left_out), false).await.unwrap();
        store.sweep_trash(Millis(i64::MAX)).await.unwrap();
        store.label_episodes(std::slice::from_ref(&failure), &label(Outcome::Success)).await.unwrap();
        assert_eq!(store.snapshot_changes(&id).await.unwrap(), SnapshotChanges { relabelled: 1, deleted: 0 });
    }

    #[tokio::test]
    async fn changes_are_counted_without_the_other_episodes() {
        let (_dir, store) = testing::sqlite().await;
        let plan = testing::plan(&store, CHANGES).await;
        let scans: Vec<&String> = plan.iter().filter(|step| step.contains("SCAN")).collect();
        let few = |step: &String| step.contains("episodes_purged") || step.contains("CONSTANT");
        assert!(scans.iter().all(|step| few(step)), "{plan:?}");
    }

    #[tokio::test]
    async fn an_episode_lists_its_newest_snapshots() {
        let (_dir, store) = testing::store().await;
        let task = testing::task(&store).await;
        let expert = testing::episode(&store, &task, Outcome::Success, "").await.id;
        let failure = testing::episode(&store, &task, Outcome::Failure, "").await.id;
        assert_eq!(store.snapshots_with(&expert, 8).await.unwrap().1, 0);
        let mut made = Vec::new();
        for _ in 0..3 {
            made.push(store.create_snapshot(&task.id, &RoleRule::default()).await.unwrap().id);
        }
        let (uses, of) = store.snapshots_with(&failure, 2).await.unwrap();
        assert_eq!(of, 3);
        assert_eq!(uses.iter().map(|held| &held.snapshot_id).collect::<Vec<_>>(), [&made[2], &made[1]]);
        assert_eq!((uses[0].role, uses[0].outcome), (Role::Imperfect, Outcome::Failure));
    }
}
