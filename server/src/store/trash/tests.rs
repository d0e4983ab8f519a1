//! The trash: deletion, restoration and the sweep.

use super::*;
use crate::{
    domain::{
        episode::{EpisodeFilter, NewLabel, Outcome},
        job::JobState,
        snapshot::RoleRule,
        task::Task,
    },
    error::Kind,
    store::testing::{self, results},
};

const LATER: Millis = Millis(i64::MAX);

fn filter(task: &Task, deleted: bool) -> EpisodeFilter {
    EpisodeFilter { task_id: task.id.clone(), outcome: None, cohort: None, deleted }
}

async fn listed(store: &Store, task: &Task, deleted: bool) -> Vec<EpisodeId> {
    let (episodes, _) = store.episodes(&filter(task, deleted), None, 100).await.unwrap();
    episodes.into_iter().map(|episode| episode.id).collect()
}

#[tokio::test]
async fn deleted_episodes_are_invisible_and_can_be_restored() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    let kept = testing::episode(&store, &task, Outcome::Success, "").await.id;
    let gone = testing::episode(&store, &task, Outcome::Success, "").await.id;
    let other = testing::episode(&store, &task, Outcome::Failure, "").await.id;

    let deleted = store.delete_episodes(std::slice::from_ref(&gone), false).await.unwrap();
    let since = deleted[0].deleted_at.unwrap();
    assert_eq!(store.delete_episodes(std::slice::from_ref(&gone), false).await.unwrap()[0].deleted_at, Some(since));
    assert_eq!(listed(&store, &task, false).await, [kept.clone(), other.clone()]);
    assert_eq!(listed(&store, &task, true).await, std::slice::from_ref(&gone));
    assert_eq!(store.outcome_counts(&task.id).await.unwrap().success, 1);
    assert_eq!(store.tasks().await.unwrap()[0].1.success, 1);
    let snapshot = store.create_snapshot(&task.id, &RoleRule::default()).await.unwrap();
    assert_eq!((snapshot.expert_episodes, snapshot.imperfect_episodes), (1, 1));
    assert_eq!(store.episode(&gone).await.unwrap().episode.deleted_at, Some(since), "it can be looked at");
    let label =
        NewLabel { outcome: Some(Outcome::Failure), cohort: None, author: String::new(), reason: String::new() };
    let error = store.label_episodes(std::slice::from_ref(&gone), &label).await.unwrap_err();
    assert_eq!(error.kind(), Kind::Precondition, "{error}");

    assert!(store.undelete_episodes(std::slice::from_ref(&gone)).await.unwrap()[0].deleted_at.is_none());
    assert_eq!(listed(&store, &task, false).await, [kept, gone, other]);
    assert_eq!(store.sweep_trash(LATER).await.unwrap().removed, 0);
}

#[tokio::test]
async fn all_or_none_are_deleted() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    let mut ids = Vec::new();
    for _ in 0..=episode::BATCH {
        ids.push(testing::episode(&store, &task, Outcome::Success, "").await.id);
    }
    let with_unknown = [ids.clone(), vec![EpisodeId::new()]].concat();
    let error = store.delete_episodes(&with_unknown, false).await.unwrap_err();
    assert_eq!(error.kind(), Kind::NotFound);
    assert_eq!(listed(&store, &task, false).await, ids);
    store.delete_episodes(&ids[1..], false).await.unwrap();
    let error = store.undelete_episodes(&with_unknown).await.unwrap_err();
    assert_eq!(error.kind(), Kind::NotFound);
    assert_eq!(listed(&store, &task, false).await, ids[..1]);
    let back = store.undelete_episodes(&ids).await.unwrap();
    assert_eq!(back.into_iter().map(|episode| episode.id).collect::<Vec<_>>(), ids);
}

#[tokio::test]
async fn an_episode_of_a_snapshot_is_deleted_by_force_only_and_keeps_its_row() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    let expert = testing::episode(&store, &task, Outcome::Success, "").await;
    testing::episode(&store, &task, Outcome::Failure, "").await;
    let encoder = results::encoder(&store, &task).await;
    let policy = results::policy(&store, &task, &encoder, blake3::hash(b"policy").into()).await;
    let ids = [expert.id.clone()];

    let error = store.delete_episodes(&ids, false).await.unwrap_err();
    assert_eq!(error.kind(), Kind::Precondition);
    assert!(
        error.message().contains(encoder.snapshot_id.as_str()) && error.message().contains("1 policies"),
        "{error}"
    );
    assert!(store.episode(&expert.id).await.unwrap().episode.deleted_at.is_none());

    store.delete_episodes(&ids, true).await.unwrap();
    assert_eq!(store.snapshot(&encoder.snapshot_id).await.unwrap().1.len(), 2, "the snapshot is unchanged");
    let swept = store.sweep_trash(LATER).await.unwrap();
    assert_eq!((swept.removed, swept.purged), (0, 0), "jobs of the task are under way");
    for job in [&encoder.job_id, policy.job_id().unwrap()] {
        results::set_state(&store, job, JobState::Failed, "").await;
    }
    assert_eq!(store.sweep_trash(Millis(0)).await.unwrap().purged, 0, "not yet");
    store.expect_recordings(&encoder.snapshot_id).await.unwrap();
    let swept = store.sweep_trash(LATER).await.unwrap();
    assert_eq!(
        (swept.removed, swept.purged, swept.episodes),
        (0, 1, vec![(expert.id.clone(), expert.recording.clone())])
    );
    assert!(!store.names_blob(&expert.recording).await.unwrap());
    let (_, members) = store.snapshot(&encoder.snapshot_id).await.unwrap();
    assert_eq!(members.len(), 2);
    let error = store.expect_recordings(&encoder.snapshot_id).await.unwrap_err();
    assert!(error.kind() == Kind::Precondition && error.message().contains(expert.id.as_str()), "{error}");
    assert_eq!(store.expect_recordings(&encoder.snapshot_id).await.unwrap_err().kind(), Kind::Precondition);
    assert_eq!(store.episode(&expert.id).await.unwrap_err().kind(), Kind::NotFound);
    assert_eq!(store.undelete_episodes(&ids).await.unwrap_err().kind(), Kind::NotFound);
    assert!(listed(&store, &task, true).await.is_empty());

    // The same recording, uploaded again, is the same episode, and the snapshot is complete.
    let upload = crate::domain::episode::Upload {
        blake3: expert.recording.clone(),
        outcome: Outcome::Failure,
        ..testing::upload(&task, b"")
    };
    assert!(store.episode_of(&task.id, &expert.recording).await.unwrap().is_none());
    let again = store.finish_upload(&upload, &testing::inspected(&task, &upload)).await.unwrap();
    assert_eq!((again.id, again.outcome), (expert.id.clone(), Outcome::Failure));
    store.expect_recordings(&encoder.snapshot_id).await.unwrap();
    assert_eq!(store.labels(&expert.id).await.unwrap().len(), 2);
    assert!(store.names_blob(&expert.recording).await.unwrap());
}

#[tokio::test]
async fn a_sweep_removes_unneeded_episodes_completely() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    let gone = testing::episode(&store, &task, Outcome::Success, "").await;
    store.delete_episodes(std::slice::from_ref(&gone.id), false).await.unwrap();
    assert!(store.names_blob(&gone.recording).await.unwrap());
    let swept = store.sweep_trash(LATER).await.unwrap();
    assert_eq!((swept.removed, swept.purged, swept.episodes), (1, 0, vec![(gone.id.clone(), gone.recording.clone())]));
    assert_eq!(store.labels(&gone.id).await.unwrap_err().kind(), Kind::NotFound);
    assert!(!store.names_blob(&gone.recording).await.unwrap());
    assert!(store.episode_of(&task.id, &gone.recording).await.unwrap().is_none());
}

/// As many as two and a half writes remove, deleted by force, so that none of them is purged before it is removed.
#[tokio::test]
async fn a_large_trash_is_emptied_in_parts_and_each_episode_counts_once() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    let mut gone = Vec::new();
    for _ in 0..=2 * BATCH {
        gone.push(testing::episode(&store, &task, Outcome::Success, "").await);
    }
    let kept = testing::episode(&store, &task, Outcome::Success, "").await;
    let ids: Vec<EpisodeId> = gone.iter().map(|episode| episode.id.clone()).collect();
    store.delete_episodes(&ids, true).await.unwrap();
    let mut swept = store.sweep_trash(LATER).await.unwrap();
    assert_eq!((swept.removed, swept.purged), (ids.len() as u64, 0));
    swept.episodes.sort();
    let mut expected: Vec<_> = gone.into_iter().map(|episode| (episode.id, episode.recording)).collect();
    expected.sort();
    assert_eq!(swept.episodes, expected);
    assert_eq!(listed(&store, &task, false).await, std::slice::from_ref(&kept.id));
    assert_eq!(store.labels(&kept.id).await.unwrap().len(), 1);
}
