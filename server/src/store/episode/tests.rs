//! Tests of episode rows: labels with history, pages.

#![allow(clippy::unwrap_used, reason = "tests only")]

use super::*;
use crate::{error::Kind, store::testing};

fn label(outcome: Outcome, cohort: Option<&str>) -> NewLabel {
    NewLabel { outcome, cohort: cohort.map(str::to_owned), author: "ada".into(), reason: "watched it".into() }
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
    let history = store.labels(&first.id).await.unwrap();
    let words: Vec<_> = history.iter().map(|l| (l.outcome, l.cohort.as_str(), l.reason.as_str())).collect();
    assert_eq!(
        words,
        [
            (Outcome::Unknown, "bob", ""),
            (Outcome::Failure, "bob", "watched it"),
            (Outcome::Success, "dave", "watched it"),
        ]
    );
    assert_eq!(store.labels(&second.id).await.unwrap().len(), 2, "named twice, labelled once");
}

#[tokio::test]
async fn one_unknown_episode_labels_none() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    let known = testing::episode(&store, &task, Outcome::Unknown, "").await;
    let unknown = EpisodeId::new();
    let ids = [known.id.clone(), unknown.clone()];
    let error = store.label_episodes(&ids, &label(Outcome::Success, None)).await.unwrap_err();
    assert_eq!(error.kind(), Kind::NotFound);
    assert!(error.message().contains(unknown.as_str()), "{error}");
    assert_eq!(store.episode(&known.id).await.unwrap().episode.outcome, Outcome::Unknown);
    assert_eq!(store.labels(&known.id).await.unwrap().len(), 1);
    assert_eq!(store.labels(&unknown).await.unwrap_err().kind(), Kind::NotFound);
    assert_eq!(store.episode(&unknown).await.unwrap_err().kind(), Kind::NotFound);
}

#[tokio::test]
async fn pages_meet_without_gap_or_overlap() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    let mut all = Vec::new();
    for number in 0..7 {
        let cohort = if number % 2 == 0 { "even" } else { "odd" };
        all.push(testing::episode(&store, &task, Outcome::Success, cohort).await.id);
    }
    all.sort();
    let filter = EpisodeFilter { task_id: task.id.clone(), outcome: None, cohort: None, deleted: false };
    let (mut paged, mut after, mut pages) = (Vec::new(), None, 0);
    loop {
        let (page, next) = store.episodes(&filter, after.as_ref(), 3).await.unwrap();
        paged.extend(page.into_iter().map(|episode| episode.id));
        pages += 1;
        if next.is_none() {
            break;
        }
        after = next;
    }
    assert_eq!((paged, pages), (all, 3));
    let even = EpisodeFilter { outcome: Some(Outcome::Success), cohort: Some("even".into()), ..filter.clone() };
    let (page, next) = store.episodes(&even, None, 4).await.unwrap();
    assert_eq!((page.len(), next), (4, None), "a full last page has no next");
    let failures = EpisodeFilter { outcome: Some(Outcome::Failure), ..filter };
    assert!(store.episodes(&failures, None, 9).await.unwrap().0.is_empty());
}
