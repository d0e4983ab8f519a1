//! Tests of episode rows: pages.

use super::*;
use crate::{domain::episode::Outcome, store::testing};

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
