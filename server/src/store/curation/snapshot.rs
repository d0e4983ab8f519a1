//! Snapshots and their episodes, in both directions.

use crate::{
    domain::{
        curation::{FrozenEpisode, LabelSeen, SnapshotUse, Standing},
        episode::Outcome,
        id::{EpisodeId, SnapshotId},
        snapshot::Role,
        time::Millis,
    },
    error::Result,
    store::{Store, fault, row},
};

#[derive(sqlx::FromRow)]
struct FrozenRow {
    episode_id: String,
    file_name: String,
    role: String,
    outcome: String,
    cohort: String,
    version: Option<i64>,
    outcome_now: String,
    cohort_now: String,
    version_now: Option<i64>,
    in_trash: bool,
    purged: bool,
}

impl FrozenRow {
    fn read(self) -> Result<FrozenEpisode> {
        Ok(FrozenEpisode {
            episode_id: row::id("snapshot_episodes.episode_id", self.episode_id)?,
            file_name: self.file_name,
            role: row::parsed("snapshot_episodes.role", Role::from_word(&self.role))?,
            then: LabelSeen {
                outcome: row::parsed("snapshot_episodes.outcome", Outcome::from_word(&self.outcome))?,
                cohort: self.cohort,
                version: self.version,
            },
            now: LabelSeen {
                outcome: row::parsed("episodes.outcome", Outcome::from_word(&self.outcome_now))?,
                cohort: self.cohort_now,
                version: self.version_now,
            },
            standing: match (self.purged, self.in_trash) {
                (true, _) => Standing::Deleted,
                (false, true) => Standing::InTrash,
                (false, false) => Standing::Present,
            },
        })
    }
}

#[derive(sqlx::FromRow)]
struct UseRow {
    snapshot_id: String,
    created_at: i64,
    role: String,
    outcome: String,
    cohort: String,
    of: i64,
}

impl UseRow {
    fn read(self) -> Result<SnapshotUse> {
        Ok(SnapshotUse {
            snapshot_id: row::id("snapshot_episodes.snapshot_id", self.snapshot_id)?,
            created_at: Millis(self.created_at),
            role: row::parsed("snapshot_episodes.role", Role::from_word(&self.role))?,
            outcome: row::parsed("snapshot_episodes.outcome", Outcome::from_word(&self.outcome))?,
            cohort: self.cohort,
        })
    }
}

impl Store {
    /// The episodes of a snapshot in its order, with their labels then and now; no episode for an unknown snapshot.
    ///
    /// A snapshot stores labels, not their versions: the version is that of the newest equal label that is not younger
    /// than the snapshot.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn frozen_episodes(&self, id: &SnapshotId) -> Result<Vec<FrozenEpisode>> {
        let rows: Vec<FrozenRow> = sqlx::query_as(
            "select held.episode_id, file_name, role, held.outcome, held.cohort, episodes.outcome as outcome_now, \
                 episodes.cohort as cohort_now, deleted_at is not null as in_trash, purged_at is not null as purged, \
                 (select max(labels.id) from labels where labels.episode_id = held.episode_id \
                      and labels.outcome = held.outcome and labels.cohort = held.cohort \
                      and labels.created_at <= snapshots.created_at) as version, \
                 (select max(labels.id) from labels where labels.episode_id = held.episode_id) as version_now \
             from snapshot_episodes held join snapshots on snapshots.id = held.snapshot_id \
                 join episodes on episodes.id = held.episode_id \
             where held.snapshot_id = ? order by held.position",
        )
        .bind(id.as_str())
        .fetch_all(self.read())
        .await
        .map_err(fault("reading a snapshot's episodes and their labels"))?;
        rows.into_iter().map(FrozenRow::read).collect()
    }

    /// At most `most` snapshots that contain an episode, newest first, and the number of all of them.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn snapshots_with(&self, episode: &EpisodeId, most: u32) -> Result<(Vec<SnapshotUse>, u64)> {
        let rows: Vec<UseRow> = sqlx::query_as(
            "select snapshot_id, created_at, role, outcome, cohort, count(*) over () as \"of\" \
             from snapshot_episodes join snapshots on snapshots.id = snapshot_id \
             where episode_id = ? order by created_at desc, snapshot_id desc limit ?",
        )
        .bind(episode.as_str())
        .bind(most)
        .fetch_all(self.read())
        .await
        .map_err(fault("reading the snapshots of an episode"))?;
        let of = rows.first().map_or(Ok(0), |row| row::count("of", row.of))?;
        Ok((rows.into_iter().map(UseRow::read).collect::<Result<_>>()?, of))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        domain::{episode::NewLabel, snapshot::RoleRule},
        store::testing,
    };

    fn label(outcome: Outcome) -> NewLabel {
        NewLabel { outcome, cohort: None, author: "ada".into(), reason: String::new() }
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
            let held = store.frozen_episodes(&id).await.unwrap();
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
        assert!(store.frozen_episodes(&SnapshotId::new()).await.unwrap().is_empty());
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
