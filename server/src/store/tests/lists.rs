//! Pages of every list have each row once and in order, also when rows are added and deleted between two of them.

use std::fmt::Debug;

use crate::{
    domain::{
        dataset::ExportFile,
        episode::{NewLabel, Outcome},
        evaluation::{Evaluation, SeedResult},
        id::{EpisodeId, EvaluationId, ExportId, TaskId},
        page::Page,
        policy::Assignment,
        score::Encoder,
        selection::Selection,
        task::Task,
        time::Millis,
    },
    error::{Kind, Result},
    store::{
        Store,
        testing::{self, results},
    },
};

/// The rows of all pages, joined; `between` runs behind the first page.
async fn joined<T, K: Debug>(
    size: u32,
    read: impl AsyncFn(&Page<K>) -> Result<(Vec<T>, Option<K>)>,
    between: impl AsyncFnOnce(),
) -> Vec<T> {
    let (mut rows, mut next) = read(&Page { after: None, size }).await.unwrap();
    assert_eq!(rows.len(), usize::try_from(size).unwrap(), "the list has more rows than a page");
    assert!(next.is_some(), "the list has more rows than a page");
    between().await;
    while let Some(after) = next {
        let (more, behind) = read(&Page { after: Some(after), size }).await.unwrap();
        assert!(more.len() <= usize::try_from(size).unwrap());
        rows.extend(more);
        next = behind;
    }
    rows
}

/// A task with an expert and an imperfect episode, and an encoder of both.
async fn lab(store: &Store) -> (Task, Encoder) {
    let task = testing::task(store).await;
    testing::episode(store, &task, Outcome::Success, "").await;
    testing::episode(store, &task, Outcome::Failure, "").await;
    let encoder = results::encoder(store, &task).await;
    (task, encoder)
}

async fn named_task(store: &Store, name: &str) -> Task {
    let mut spec = testing::spec();
    spec.name = name.into();
    store.insert_task(&spec).await.unwrap()
}

#[tokio::test]
async fn pages_of_tasks_have_each_task_once_and_oldest_first() {
    let (_dir, store) = testing::store().await;
    let mut made = Vec::new();
    for name in ["a", "b", "c", "d", "e"] {
        made.push(named_task(&store, name).await);
    }
    testing::episode(&store, &made[2], Outcome::Success, "").await;
    testing::episode(&store, &made[2], Outcome::Failure, "").await;
    let ids = |tasks: Vec<(Task, _)>| tasks.into_iter().map(|(task, _)| task.id).collect::<Vec<_>>();
    for size in 1..5 {
        let pages = joined(size, async |page| store.tasks_page(page).await, async || {}).await;
        let counts: Vec<_> = pages.iter().map(|(_, counts)| (counts.success, counts.failure)).collect();
        assert_eq!(counts, [(0, 0), (0, 0), (1, 1), (0, 0), (0, 0)], "{size}");
        assert_eq!(ids(pages), ids(store.tasks().await.unwrap()), "{size}");
    }
    let change = async || {
        store.delete_task(&made[1].id).await.unwrap();
        store.delete_task(&made[3].id).await.unwrap();
        named_task(&store, "0").await;
    };
    let pages = joined(2, async |page| store.tasks_page(page).await, change).await;
    let names: Vec<_> = pages.into_iter().map(|(task, _)| task.spec.name).collect();
    // The last task of the first page is gone, and the page behind it is not.
    assert_eq!(names, ["a", "b", "c", "e", "0"]);
}

#[tokio::test]
async fn pages_of_results_have_each_row_once_and_newest_first() {
    let (_dir, store) = testing::store().await;
    let (task, encoder) = lab(&store).await;
    let other = named_task(&store, "other").await;
    for number in 0..4_u8 {
        store.create_snapshot(&task.id, &Default::default()).await.unwrap();
        let run = results::run(&store, &task, &encoder, &[]).await;
        store.insert_dataset(&run.id, Selection::beta(f64::from(number) / 10.0)).await.unwrap();
        results::policy(&store, &task, &encoder, blake3::hash(&[number]).into()).await;
    }
    let task = &task.id;
    for size in 1..4 {
        let pages = joined(size, async |page| store.snapshots_page(task, page).await, async || {}).await;
        let ids: Vec<_> = pages.into_iter().map(|snapshot| snapshot.id).collect();
        // The encoder has one of its own.
        assert!(ids.len() == 5 && ids.is_sorted_by(|newer, older| newer > older));

        let pages = joined(size, async |page| store.score_runs_page(task, page).await, async || {}).await;
        let ids: Vec<_> = pages.into_iter().map(|run| run.id).collect();
        assert!(ids.len() == 4 && ids.is_sorted_by(|newer, older| newer > older));

        let pages = joined(size, async |page| store.datasets_page(task, page).await, async || {}).await;
        let ids: Vec<_> = pages.into_iter().map(|dataset| dataset.id).collect();
        assert!(ids.len() == 4 && ids.is_sorted_by(|newer, older| newer > older));

        let pages = joined(size, async |page| store.policies_page(task, page).await, async || {}).await;
        let ids: Vec<_> = pages.into_iter().map(|policy| policy.id).collect();
        assert!(ids.len() == 4 && ids.is_sorted_by(|newer, older| newer > older));
    }
    let whole = store.policies(task).await.unwrap();
    let add = async || {
        let id = store.task_by_id(task).await.unwrap();
        results::policy(&store, &id, &encoder, blake3::hash(b"later").into()).await;
    };
    let pages = joined(2, async |page| store.policies_page(task, page).await, add).await;
    let ids = |policies: Vec<crate::domain::policy::Policy>| policies.into_iter().map(|one| one.id).collect::<Vec<_>>();
    assert_eq!(ids(pages), ids(whole), "a newer one is before the first page");
    assert!(store.snapshots_page(&other.id, &Page { after: None, size: 5 }).await.unwrap().0.is_empty());
}

#[tokio::test]
async fn pages_of_evaluations_have_each_one_once_and_newest_first() {
    let (_dir, store) = testing::store().await;
    let (task, encoder) = lab(&store).await;
    let policy = results::policy(&store, &task, &encoder, blake3::hash(b"policy").into()).await.id;
    let add = async || {
        let evaluation = Evaluation {
            id: EvaluationId::new(),
            policy_id: policy.clone(),
            job_id: None,
            simulation: "a robot".into(),
            seeds: vec![SeedResult { seed: 1, episodes: 10, successes: 3, mean_steps: 0.0 }],
            created_at: Millis::now(),
        };
        store.insert_evaluation(&evaluation).await.unwrap();
        evaluation
    };
    let mut made = Vec::new();
    for _ in 0..4 {
        made.insert(0, add().await);
    }
    let later = async || drop(add().await);
    let pages = joined(3, async |page| store.evaluations_page(&policy, page).await, later).await;
    assert_eq!(pages, made);
    assert_eq!(store.evaluations(&policy).await.unwrap().len(), 5);
}

#[tokio::test]
async fn pages_of_deployments_have_each_name_once_with_its_whole_history() {
    let (_dir, store) = testing::store().await;
    let (task, encoder) = lab(&store).await;
    let mut policies = Vec::new();
    for number in 0..2_u8 {
        policies.push(results::policy(&store, &task, &encoder, blake3::hash(&[number]).into()).await.id);
    }
    // Each is changed three times, so that a page has more changes than deployments.
    for name in ["d", "B", "a", "c@1", "c-2"] {
        for policy in [&policies[0], &policies[1], &policies[0]] {
            store.deploy(name, &task.id, &Assignment::of(policy)).await.unwrap();
        }
    }
    let whole = store.deployments(None).await.unwrap();
    let names = |deployments: &[crate::domain::policy::Deployment]| {
        deployments.iter().map(|one| one.name.clone()).collect::<Vec<_>>()
    };
    assert_eq!(names(&whole), ["B", "a", "c-2", "c@1", "d"]);
    for size in 1..5 {
        let read = async |page: &Page<String>| store.deployments_page(Some(&task.id), None, page).await;
        let pages = joined(size, read, async || {}).await;
        assert_eq!(names(&pages), names(&whole), "{size}");
        assert!(pages.iter().all(|one| one.history.len() == 3), "{size}");
    }
    let own = ["d".to_owned(), "a".to_owned(), "absent".to_owned()];
    let read = async |page: &Page<String>| store.deployments_page(None, Some(&own), page).await;
    assert_eq!(names(&joined(1, read, async || {}).await), ["a", "d"], "a robot's own");
    let first = Page { after: None, size: 5 };
    assert!(store.deployments_page(None, Some(&[]), &first).await.unwrap().0.is_empty());
    assert!(store.deployments_page(Some(&TaskId::new()), None, &first).await.unwrap().0.is_empty());

    let change = async || {
        store.delete_deployment("a").await.unwrap();
        store.delete_deployment("c@1").await.unwrap();
        store.deploy("A", &task.id, &Assignment::of(&policies[0])).await.unwrap();
        store.deploy("b", &task.id, &Assignment::of(&policies[0])).await.unwrap();
    };
    let read = async |page: &Page<String>| store.deployments_page(None, None, page).await;
    assert_eq!(names(&joined(2, read, change).await), ["B", "a", "b", "c-2", "d"]);
}

#[tokio::test]
async fn pages_of_labels_have_each_label_once_and_oldest_first() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    let episode = testing::episode(&store, &task, Outcome::Unknown, "").await.id;
    let neighbour = testing::episode(&store, &task, Outcome::Unknown, "").await.id;
    let label = async |reason: &str| {
        let (author, reason) = ("ada".into(), reason.to_owned());
        let label = NewLabel { outcome: Some(Outcome::Success), cohort: None, author, reason };
        store.label_episodes(&[neighbour.clone(), episode.clone()], &label).await.unwrap();
    };
    for reason in ["1", "2", "3"] {
        label(reason).await;
    }
    for size in 1..4 {
        let pages = joined(size, async |page| store.labels_page(&episode, page).await, async || {}).await;
        let reasons: Vec<_> = pages.into_iter().map(|label| label.reason).collect();
        assert_eq!(reasons, ["", "1", "2", "3"], "{size}");
    }
    let later = async || label("4").await;
    let pages = joined(2, async |page| store.labels_page(&episode, page).await, later).await;
    assert_eq!(pages.len(), 5);
    assert_eq!(pages[4].reason, "4");
    // Behind the last label, and of no episode.
    let behind = Page { after: Some(i64::MAX), size: 2 };
    assert!(store.labels_page(&episode, &behind).await.unwrap().0.is_empty());
    assert_eq!(store.labels_page(&EpisodeId::new(), &behind).await.unwrap_err().kind(), Kind::NotFound);
}

#[tokio::test]
async fn pages_of_files_keep_the_order_of_the_export() {
    let (_dir, store) = testing::store().await;
    let (task, encoder) = lab(&store).await;
    let run = results::run(&store, &task, &encoder, &[]).await;
    let dataset = store.insert_dataset(&run.id, Selection::beta(0.9)).await.unwrap().id;
    let file = |name: &str| ExportFile { name: name.into(), blob: blake3::hash(name.as_bytes()).into(), size_bytes: 3 };
    let files = ["z", "m", "a", "q", "b"].map(file);
    let id = results::export(&store, &task, &dataset, &files).await;
    for size in 1..5 {
        let pages = joined(size, async |page| store.export_files_page(&id, page).await, async || {}).await;
        assert_eq!(pages, files, "{size}");
    }
    let behind = Page { after: Some(u32::MAX), size: 2 };
    assert!(store.export_files_page(&id, &behind).await.unwrap().0.is_empty());
    assert_eq!(store.export_files_page(&ExportId::new(), &behind).await.unwrap_err().kind(), Kind::NotFound);
}
