//! Snapshots in a fresh database.

use super::super::testing;
use super::*;
use crate::{domain::episode::NewLabel, error::Kind};

#[tokio::test]
async fn a_snapshot_does_not_change_when_labels_do() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    let expert = testing::episode(&store, &task, Outcome::Success, "ada").await;
    let imperfect = testing::episode(&store, &task, Outcome::Failure, "bob").await;
    testing::episode(&store, &task, Outcome::Unknown, "bob").await;
    let frozen = store.create_snapshot(&task.id, &RoleRule::default()).await.unwrap();
    assert_eq!((frozen.expert_episodes, frozen.imperfect_episodes), (1, 1));

    let label = NewLabel {
        outcome: Some(Outcome::Failure),
        cohort: Some("carol".into()),
        author: "ada".into(),
        reason: String::new(),
    };
    store.label_episodes(std::slice::from_ref(&expert.id), &label).await.unwrap();
    let (snapshot, members) = store.snapshot(&frozen.id).await.unwrap();
    assert_eq!((snapshot.expert_episodes, snapshot.imperfect_episodes), (1, 1));
    let mut seen: Vec<_> = members.iter().map(|m| (&m.episode_id, m.outcome, m.cohort.as_str(), m.role)).collect();
    seen.sort_by_key(|member| member.3 == Role::Imperfect);
    assert_eq!(
        seen,
        [
            (&expert.id, Outcome::Success, "ada", Role::Expert),
            (&imperfect.id, Outcome::Failure, "bob", Role::Imperfect),
        ]
    );
    assert_eq!(store.snapshot(&SnapshotId::new()).await.unwrap_err().kind(), Kind::NotFound);
}

#[tokio::test]
async fn a_snapshot_is_renewed_if_its_rule_has_other_episodes_now() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    let first = testing::episode(&store, &task, Outcome::Success, "good").await;
    testing::episode(&store, &task, Outcome::Failure, "bad").await;
    let rule =
        RoleRule { expert_cohorts: vec!["good".into()], imperfect_cohorts: vec!["bad".into()], ..RoleRule::default() };
    let old = store.create_snapshot(&task.id, &rule).await.unwrap().id;
    assert_eq!(store.renewed_snapshot(&old).await.unwrap(), old);
    testing::episode(&store, &task, Outcome::Failure, "elsewhere").await;
    assert_eq!(store.renewed_snapshot(&old).await.unwrap(), old, "the rule leaves it out");

    let second = testing::episode(&store, &task, Outcome::Failure, "bad").await;
    let grown = store.renewed_snapshot(&old).await.unwrap();
    let (snapshot, members) = store.snapshot(&grown).await.unwrap();
    assert_eq!((snapshot.rule, snapshot.imperfect_episodes, members.len()), (rule, 2, 3));
    assert!(members.iter().any(|member| member.episode_id == second.id));
    let relabel = async |outcome, cohort: &str| {
        let (outcome, cohort) = (Some(outcome), Some(cohort.to_owned()));
        let label = NewLabel { outcome, cohort, author: "ada".into(), reason: String::new() };
        store.label_episodes(std::slice::from_ref(&first.id), &label).await.unwrap();
    };
    relabel(Outcome::Unknown, "good").await;
    assert_ne!(store.renewed_snapshot(&grown).await.unwrap(), grown, "a label is part of a snapshot");
    relabel(Outcome::Success, "elsewhere").await;
    assert_eq!(store.renewed_snapshot(&old).await.unwrap_err().kind(), Kind::Precondition);
}

#[tokio::test]
async fn a_snapshot_needs_both_sides() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    testing::episode(&store, &task, Outcome::Success, "ada").await;
    let error = store.create_snapshot(&task.id, &RoleRule::default()).await.unwrap_err();
    assert_eq!(error.kind(), Kind::Precondition);
    assert!(error.message().contains("no imperfect"), "{error}");
    let rule =
        RoleRule { expert_cohorts: vec!["bob".into()], imperfect_cohorts: vec!["ada".into()], ..RoleRule::default() };
    let error = store.create_snapshot(&task.id, &rule).await.unwrap_err();
    assert!(error.message().contains("no expert"), "{error}");
    assert!(store.snapshots(&task.id).await.unwrap().is_empty());
}

#[tokio::test]
async fn a_snapshot_is_listed_by_pages_in_its_order() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    for outcome in [Outcome::Success, Outcome::Failure, Outcome::Failure, Outcome::Success] {
        testing::episode(&store, &task, outcome, "ada").await;
    }
    let frozen = store.create_snapshot(&task.id, &RoleRule::default()).await.unwrap();
    let (_, all) = store.snapshot(&frozen.id).await.unwrap();
    let all: Vec<_> = all.into_iter().map(|member| (member.episode_id, member.role)).collect();
    for size in 1..=5 {
        let (mut listed, mut behind, mut pages) = (Vec::new(), None, 0);
        loop {
            let (page, next) = store.snapshot_episodes(&frozen.id, behind, size).await.unwrap();
            listed.extend(page.into_iter().map(|member| (member.episode_id, member.role)));
            pages += 1;
            let Some(place) = next else { break };
            behind = Some(place);
        }
        assert_eq!((&listed, pages), (&all, 4_u32.div_ceil(size)), "pages of {size}");
    }
    let absent = store.snapshot_episodes(&SnapshotId::new(), None, 5).await.unwrap_err();
    assert_eq!(absent.kind(), Kind::NotFound);
}

#[tokio::test]
async fn snapshots_are_listed_newest_first() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    testing::episode(&store, &task, Outcome::Success, "ada").await;
    testing::episode(&store, &task, Outcome::Success, "bob").await;
    let rule =
        RoleRule { expert_cohorts: vec!["ada".into()], imperfect_cohorts: vec!["bob".into()], ..RoleRule::default() };
    for _ in 0..3 {
        store.create_snapshot(&task.id, &rule).await.unwrap();
    }
    let listed = store.snapshots(&task.id).await.unwrap();
    assert_eq!((listed.len(), &listed[0].rule), (3, &rule));
    assert!(listed.windows(2).all(|pair| pair[0].created_at >= pair[1].created_at));
}

#[tokio::test]
async fn a_snapshot_keeps_to_its_limits() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    for _ in 0..3 {
        testing::episode(&store, &task, Outcome::Success, "ada").await;
    }
    for cohort in ["bob", "bob", "bob", "bob", "carol", "carol"] {
        testing::episode(&store, &task, Outcome::Failure, cohort).await;
    }
    let rule = RoleRule { imperfect_per_expert: 2.0, max_experts: 2, seed: 1, ..RoleRule::default() };
    let frozen = store.create_snapshot(&task.id, &rule).await.unwrap();
    assert_eq!((frozen.expert_episodes, frozen.imperfect_episodes), (2, 4));
    let (read, members) = store.snapshot(&frozen.id).await.unwrap();
    assert_eq!(read.rule, rule);
    assert_eq!(members.iter().filter(|member| member.cohort == "carol").count(), 2, "cohorts come evenly");
    let mut recordings = Vec::new();
    for member in &members {
        recordings.push(store.episode(&member.episode_id).await.unwrap().episode.recording);
    }
    assert!(recordings.is_sorted(), "ordered by content, not by arrival");

    let none = RoleRule { imperfect_per_expert: 0.1, ..RoleRule::default() };
    let error = store.create_snapshot(&task.id, &none).await.unwrap_err();
    assert!(error.kind() == Kind::Precondition && error.message().contains("imperfect_per_expert"), "{error}");
}
