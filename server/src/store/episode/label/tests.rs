//! Labels with history, from one client and from two at once.

use super::*;
use crate::{
    domain::{episode::Outcome, task::Task},
    error::Kind,
    store::testing,
};

fn label(outcome: Outcome, cohort: Option<&str>) -> NewLabel {
    NewLabel {
        outcome: Some(outcome),
        cohort: cohort.map(str::to_owned),
        author: "ada".into(),
        reason: "watched it".into(),
    }
}

#[tokio::test]
async fn every_label_is_kept() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    let first = testing::episode(&store, &task, Outcome::Unknown, "bob").await;
    let second = testing::episode(&store, &task, Outcome::Success, "carol").await;
    let ids = [second.id.clone(), first.id.clone(), second.id.clone()];
    let labelled = store.label_episodes(&ids, &label(Outcome::Failure, None)).await.unwrap();
    assert_eq!(
        labelled.iter().map(|e| (&e.id, e.outcome, e.cohort.as_str())).collect::<Vec<_>>(),
        [(&second.id, Outcome::Failure, "carol"), (&first.id, Outcome::Failure, "bob"),]
    );
    store.label_episodes(&ids[1..2], &label(Outcome::Success, Some("dave"))).await.unwrap();
    let now = store.episode(&first.id).await.unwrap().episode;
    assert_eq!((now.outcome, now.cohort.as_str()), (Outcome::Success, "dave"));
    let cohort = NewLabel { outcome: None, ..label(Outcome::Unknown, Some("night")) };
    store.label_episodes(&[first.id.clone(), second.id.clone()], &cohort).await.unwrap();
    let history = store.labels(&first.id).await.unwrap();
    let words: Vec<_> = history.iter().map(|l| (l.outcome, l.cohort.as_str(), l.reason.as_str())).collect();
    assert_eq!(
        words,
        [
            (Outcome::Unknown, "bob", ""),
            (Outcome::Failure, "bob", "watched it"),
            (Outcome::Success, "dave", "watched it"),
            (Outcome::Success, "night", "watched it"),
        ]
    );
    let kept = store.episode(&second.id).await.unwrap().episode;
    assert_eq!((kept.outcome, kept.cohort.as_str()), (Outcome::Failure, "night"), "each keeps its own outcome");
    assert_eq!(store.labels(&second.id).await.unwrap().len(), 3, "named twice, labelled once");
}

#[tokio::test]
async fn one_unknown_episode_labels_none() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    let known = testing::episode(&store, &task, Outcome::Unknown, "").await;
    let (unknown, other) = (EpisodeId::new(), testing::episode(&store, &task, Outcome::Unknown, "").await);
    let ids = [known.id.clone(), other.id, unknown.clone()];
    let error = store.label_episodes(&ids, &label(Outcome::Success, None)).await.unwrap_err();
    assert_eq!(error.kind(), Kind::NotFound);
    assert!(error.message().contains(unknown.as_str()), "{error}");
    assert_eq!(store.episode(&known.id).await.unwrap().episode.outcome, Outcome::Unknown);
    assert_eq!(store.labels(&known.id).await.unwrap().len(), 1);
    assert_eq!(store.labels(&unknown).await.unwrap_err().kind(), Kind::NotFound);
    assert_eq!(store.episode(&unknown).await.unwrap_err().kind(), Kind::NotFound);
}

/// Three episodes and the versions of their labels as a client read them.
async fn seen(store: &Store, task: &Task) -> Vec<(EpisodeId, i64)> {
    for cohort in ["ada", "bob", "carol"] {
        testing::episode(store, task, Outcome::Unknown, cohort).await;
    }
    let rows = store.episode_table(&task.id, &crate::domain::curation::TableFilter::default()).await.unwrap();
    rows.into_iter().map(|row| (row.episode.id, row.label_version)).collect()
}

#[tokio::test]
async fn a_label_on_the_current_version_returns_the_next_version() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    let mut versions = seen(&store, &task).await;
    versions.push(versions[0].clone());
    for outcome in [Outcome::Failure, Outcome::Success] {
        let labelled = store.label_episodes_as_seen(&versions, &label(outcome, None)).await.unwrap();
        let Labelled::Done(done) = labelled else { panic!("{labelled:?}") };
        assert_eq!(done.len(), 3, "named twice, labelled once");
        assert!(done.iter().all(|(episode, _)| episode.outcome == outcome));
        assert!(done.iter().zip(&versions).all(|(now, before)| now.0.id == before.0 && now.1 > before.1));
        versions = done.into_iter().map(|(episode, version)| (episode.id, version)).collect();
    }
    assert_eq!(store.labels(&versions[2].0).await.unwrap().len(), 3);
}

#[tokio::test]
async fn a_label_on_an_old_version_changes_nothing_and_returns_the_newer_label() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    let versions = seen(&store, &task).await;
    let first = NewLabel { author: "grace".into(), ..label(Outcome::Success, Some("dave")) };
    store.label_episodes(&[versions[1].0.clone()], &first).await.unwrap();

    let labelled = store.label_episodes_as_seen(&versions, &label(Outcome::Failure, None)).await.unwrap();
    let Labelled::Changed(changed) = labelled else { panic!("{labelled:?}") };
    assert_eq!(changed.len(), 1);
    let Overtaken { episode_id, label_version, label: by } = &changed[0];
    assert_eq!((episode_id, by.author.as_str(), by.outcome), (&versions[1].0, "grace", Outcome::Success));
    assert_eq!((by.cohort.as_str(), by.reason.as_str()), ("dave", "watched it"));
    for (place, count) in [(0, 1), (1, 2), (2, 1)] {
        assert_eq!(store.labels(&versions[place].0).await.unwrap().len(), count, "{place}");
    }
    // The second client reads the new version and labels again.
    let again = [versions[0].clone(), (episode_id.clone(), *label_version)];
    let done = store.label_episodes_as_seen(&again, &label(Outcome::Failure, None)).await.unwrap();
    assert!(matches!(done, Labelled::Done(done) if done.len() == 2));
}

#[tokio::test]
async fn of_two_concurrent_labels_one_is_first() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    let versions = seen(&store, &task).await;
    let (success, failure) = (label(Outcome::Success, None), label(Outcome::Failure, None));
    let both = tokio::join!(
        store.label_episodes_as_seen(&versions, &success),
        store.label_episodes_as_seen(&versions, &failure),
    );
    let both = [both.0.unwrap(), both.1.unwrap()];
    assert_eq!(both.iter().filter(|one| matches!(one, Labelled::Done(_))).count(), 1);
    assert!(both.iter().any(|one| matches!(one, Labelled::Changed(changed) if changed.len() == 3)));
}

#[tokio::test]
async fn unknown_or_deleted_episodes_are_rejected_at_any_version() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    let mut versions = seen(&store, &task).await;
    store.delete_episodes(&[versions[2].0.clone()], false).await.unwrap();
    let trashed = store.label_episodes_as_seen(&versions, &label(Outcome::Success, None)).await.unwrap_err();
    assert_eq!(trashed.kind(), Kind::Precondition, "{trashed}");
    versions[2] = (EpisodeId::new(), 1);
    let unknown = store.label_episodes_as_seen(&versions, &label(Outcome::Success, None)).await.unwrap_err();
    assert_eq!(unknown.kind(), Kind::NotFound, "{unknown}");
    assert_eq!(store.labels(&versions[0].0).await.unwrap().len(), 1);
}
