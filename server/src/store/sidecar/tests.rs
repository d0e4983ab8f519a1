//! The queue of sidecars, and rows that equal those they were restored from.

use super::{super::testing, *};
use crate::domain::episode::{NewLabel, Outcome};

#[tokio::test]
async fn every_change_that_a_sidecar_repeats_is_queued_and_a_later_one_stays_queued() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    let episode = testing::episode(&store, &task, Outcome::Unknown, "").await;
    let first = store.undescribed(None, 9).await.unwrap();
    assert_eq!(first.iter().map(|row| row.id.as_str()).collect::<Vec<_>>(), [task.id.as_str(), episode.id.as_str()]);
    let label = NewLabel { outcome: Some(Outcome::Success), cohort: None, author: "ada".into(), reason: String::new() };
    store.label_episodes(std::slice::from_ref(&episode.id), &label).await.unwrap();
    store.note_described(&first).await.unwrap();
    let left = store.undescribed(None, 9).await.unwrap();
    assert_eq!((left.len(), left[0].id.as_str()), (1, episode.id.as_str()), "labelled after it was listed");
    store.note_described(&left).await.unwrap();
    store.delete_episodes(std::slice::from_ref(&episode.id), false).await.unwrap();
    assert_eq!(store.undescribed(None, 9).await.unwrap().len(), 1);
    let Described::Beside(blob, Description::Recording(described)) =
        store.description(episode.id.as_str()).await.unwrap()
    else {
        unreachable!("it is an episode")
    };
    assert_eq!(
        (&blob, described.episode.outcome, described.author.as_str()),
        (&episode.recording, Outcome::Success, "ada")
    );
    assert!(described.episode.deleted_at.is_some());
}

#[tokio::test]
async fn a_restored_episode_equals_the_original() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    let episode = testing::episode(&store, &task, Outcome::Failure, "night").await;
    let Described::Beside(_, Description::Recording(described)) = store.description(episode.id.as_str()).await.unwrap()
    else {
        unreachable!("it is an episode")
    };
    let (_other, empty) = testing::store().await;
    assert_eq!(empty.restore_episode((*described).clone()).await.unwrap_err().kind(), Kind::NotFound);
    assert_eq!(empty.restore_task(&task).await.unwrap(), (task.id.clone(), true));
    assert_eq!(empty.restore_task(&task).await.unwrap(), (task.id.clone(), false));
    assert!(empty.restore_episode((*described).clone()).await.unwrap());
    assert!(!empty.restore_episode((*described).clone()).await.unwrap());
    let again = empty.episode(&episode.id).await.unwrap();
    assert_eq!(Description::recording(&again, &described.author), Description::Recording(described));
}

#[tokio::test]
async fn queued_episodes_are_at_the_end_of_the_queue_once_each() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    let mut ids = Vec::new();
    for _ in 0..=2 * episode::BATCH {
        ids.push(testing::episode(&store, &task, Outcome::Unknown, "").await.id);
    }
    let queued = async || {
        let rows = store.undescribed(None, 99).await.unwrap();
        rows.into_iter().map(|row| row.id).collect::<Vec<_>>()
    };
    store.note_described(&store.undescribed(None, 3).await.unwrap()).await.unwrap();
    ids.reverse();
    store.queue_sidecars(&ids).await.unwrap();
    assert_eq!(queued().await, ids.iter().map(EpisodeId::as_str).collect::<Vec<_>>());
}
