//! Counting labels, starting, pausing.

use gleaner_core::PretrainSpec;

use super::*;
use crate::{
    domain::{
        episode::{NewLabel, Outcome},
        order::Plan,
        schedule::PipelineSpec,
        snapshot::RoleRule,
        task::Task,
    },
    error::Kind,
    store::testing,
};

async fn schedule(store: &Store, task: &Task, name: &str) -> Result<Schedule> {
    triggered(store, &task.id, name, Trigger::LabelledEpisodes(3)).await
}

async fn triggered(store: &Store, task: &TaskId, name: &str, trigger: Trigger) -> Result<Schedule> {
    store
        .insert_schedule(&Schedule {
            id: ScheduleId::new(),
            task_id: task.clone(),
            name: name.to_owned(),
            trigger,
            pipeline: Ok(PipelineSpec {
                snapshot_id: None,
                rule: RoleRule::default(),
                pretrain: PretrainSpec::default(),
                score: true,
                scoring: None,
                beta: Some(0.9),
                top_fraction: None,
                shape: crate::domain::selection::SelectionShape::default(),
                train: None,
                evaluate: None,
            }),
            engine_options: "--partition=gpu".to_owned(),
            paused: false,
            next_run_at: None,
            last_run_at: None,
            label_mark: 0,
            labelled_since: 0,
            last_error: String::new(),
        })
        .await
}

async fn label(store: &Store, episode: &crate::domain::id::EpisodeId, outcome: Outcome) {
    let label = NewLabel { outcome: Some(outcome), cohort: None, author: "tests".into(), reason: String::new() };
    store.label_episodes(std::slice::from_ref(episode), &label).await.unwrap();
}

async fn labelled_since(store: &Store, id: &ScheduleId) -> u32 {
    store.schedule(id).await.unwrap().labelled_since
}

#[tokio::test]
async fn each_newly_labelled_episode_counts_once() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    testing::episode(&store, &task, Outcome::Success, "").await;
    let made = schedule(&store, &task, "often").await.unwrap();
    assert_eq!(made.engine_options, "--partition=gpu");
    let id = made.id;
    assert_eq!(labelled_since(&store, &id).await, 0, "labels from before do not count");

    let one = testing::episode(&store, &task, Outcome::Success, "").await;
    label(&store, &one.id, Outcome::Failure).await;
    assert_eq!(labelled_since(&store, &id).await, 1, "labelled twice, counted once");
    let silent = testing::episode(&store, &task, Outcome::Unknown, "").await;
    assert_eq!(labelled_since(&store, &id).await, 1, "unknown does not count");
    label(&store, &silent.id, Outcome::Success).await;
    assert_eq!(labelled_since(&store, &id).await, 2);

    let mut other = testing::spec();
    other.name = "other".into();
    let other = store.insert_task(&other).await.unwrap();
    testing::episode(&store, &other, Outcome::Success, "").await;
    assert_eq!(labelled_since(&store, &id).await, 2, "another task's labels do not count");
}

#[tokio::test]
async fn a_start_resets_the_count_and_the_error() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    let id = schedule(&store, &task, "often").await.unwrap().id;
    testing::episode(&store, &task, Outcome::Success, "").await;
    store.schedule_failed(&id, "no imperfect episode", None).await.unwrap();
    let failed = store.schedule(&id).await.unwrap();
    assert_eq!((failed.last_error.as_str(), failed.labelled_since), ("no imperfect episode", 1));

    let label_mark = store.newest_label().await.unwrap();
    let start = ScheduleStart { id: id.clone(), at: Millis(7), next_run_at: None, label_mark };
    store.insert_plan(&Plan { start: Some(start), ..Plan::default() }).await.unwrap();
    let started = store.schedule(&id).await.unwrap();
    assert_eq!((started.last_error.as_str(), started.labelled_since), ("", 0));
    assert_eq!(started.last_run_at, Some(Millis(7)));
}

#[tokio::test]
async fn labels_during_a_pause_are_not_counted() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    let id = schedule(&store, &task, "often").await.unwrap().id;
    store.pause_schedule(&id, true, None).await.unwrap();
    testing::episode(&store, &task, Outcome::Success, "").await;
    assert_eq!(labelled_since(&store, &id).await, 0);
    store.pause_schedule(&id, false, None).await.unwrap();
    assert_eq!(labelled_since(&store, &id).await, 0, "labels during the pause are not counted");
    testing::episode(&store, &task, Outcome::Success, "").await;
    store.pause_schedule(&id, false, None).await.unwrap();
    assert_eq!(labelled_since(&store, &id).await, 1, "resuming a running schedule changes nothing");
}

#[tokio::test]
async fn names_are_unique_within_a_task_and_deletion_is_final() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    let id = schedule(&store, &task, "often").await.unwrap().id;
    assert_eq!(schedule(&store, &task, "often").await.unwrap_err().kind(), Kind::Exists);
    schedule(&store, &task, "seldom").await.unwrap();
    assert_eq!(store.schedules(Some(&task.id), None, 9).await.unwrap().0.len(), 2);
    assert!(store.schedules(Some(&TaskId::new()), None, 9).await.unwrap().0.is_empty());
    store.delete_schedule(&id).await.unwrap();
    assert_eq!(store.delete_schedule(&id).await.unwrap_err().kind(), Kind::NotFound);
    assert_eq!(store.schedules(None, None, 9).await.unwrap().0.len(), 1);
}

/// A start takes seconds where it takes a snapshot of a large task.
#[tokio::test]
async fn a_schedule_that_is_paused_or_deleted_during_its_start_queues_no_job() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    let (paused, deleted) =
        (schedule(&store, &task, "paused").await.unwrap().id, schedule(&store, &task, "deleted").await.unwrap().id);
    store.pause_schedule(&paused, true, None).await.unwrap();
    store.delete_schedule(&deleted).await.unwrap();
    for id in [&paused, &deleted] {
        let start = ScheduleStart { id: id.clone(), at: Millis(7), next_run_at: Some(Millis(9)), label_mark: 0 };
        let error = store.insert_plan(&Plan { start: Some(start), ..Plan::default() }).await.unwrap_err();
        assert!(error.kind() == Kind::Precondition && error.message().contains(id.as_str()), "{error}");
        store.schedule_failed(id, error.message(), Some(Millis(9))).await.unwrap();
    }
    let paused = store.schedule(&paused).await.unwrap();
    assert_eq!((paused.last_run_at, paused.next_run_at, paused.last_error.as_str()), (None, None, ""));
}

/// A start takes seconds, and the schedule may be paused and resumed meanwhile.
#[tokio::test]
async fn labels_of_a_pause_during_a_start_are_not_counted() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    let id = schedule(&store, &task, "often").await.unwrap().id;
    let label_mark = store.newest_label().await.unwrap();
    store.pause_schedule(&id, true, None).await.unwrap();
    testing::episode(&store, &task, Outcome::Success, "").await;
    store.pause_schedule(&id, false, None).await.unwrap();
    let start = ScheduleStart { id: id.clone(), at: Millis(7), next_run_at: None, label_mark };
    let error = store.insert_plan(&Plan { start: Some(start), ..Plan::default() }).await.unwrap_err();
    assert_eq!(error.kind(), Kind::Precondition, "{error}");
    let resumed = store.schedule(&id).await.unwrap();
    assert_eq!((resumed.labelled_since, resumed.last_run_at), (0, None));
}

#[tokio::test]
async fn labels_are_counted_for_schedules_that_wait_for_them() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    let nightly = triggered(&store, &task.id, "nightly", Trigger::Cron("0 3 * * *".into())).await.unwrap().id;
    let often = schedule(&store, &task, "often").await.unwrap().id;
    testing::episode(&store, &task, Outcome::Success, "").await;
    assert_eq!((labelled_since(&store, &nightly).await, labelled_since(&store, &often).await), (0, 1));
}

/// The caller has looked the task up, and another one deletes it before the schedule is stored.
#[tokio::test]
async fn a_schedule_of_a_deleted_task_is_refused_by_the_task() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    store.delete_task(&task.id).await.unwrap();
    let refused = schedule(&store, &task, "late").await.unwrap_err();
    assert!(refused.kind() == Kind::NotFound && refused.message().contains(task.id.as_str()), "{refused}");
}

#[tokio::test]
async fn pages_have_each_schedule_once_and_oldest_first() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    let mut other = testing::spec();
    other.name = "other".into();
    let other = store.insert_task(&other).await.unwrap();
    let mut made = Vec::new();
    for name in ["a", "b", "c", "d"] {
        made.push(schedule(&store, &task, name).await.unwrap().id);
        schedule(&store, &other, name).await.unwrap();
    }
    for size in 1..=5 {
        let (mut seen, mut after) = (Vec::new(), None);
        loop {
            let (page, next) = store.schedules(Some(&task.id), after.as_ref(), size).await.unwrap();
            assert!(page.len() <= usize::try_from(size).unwrap());
            seen.extend(page.into_iter().map(|schedule| schedule.id));
            after = next;
            if after.is_none() {
                break;
            }
        }
        assert_eq!(seen, made, "pages of {size}");
    }
    assert_eq!(store.schedules(None, None, 9).await.unwrap().0.len(), 8);
}

/// Its row is damaged, or a newer version wrote it.
#[tokio::test]
async fn a_schedule_that_cannot_be_read_is_listed_paused_and_deleted() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    let unread = schedule(&store, &task, "unread").await.unwrap().id;
    let sound = schedule(&store, &task, "sound").await.unwrap().id;
    for text in ["{\"score\":", "{\"stages\":[]}", ""] {
        testing::run(&store, &format!("update schedules set pipeline = '{text}' where id = '{unread}'")).await;
        let (listed, _) = store.schedules(Some(&task.id), None, 9).await.unwrap();
        assert_eq!(listed.iter().map(|schedule| &schedule.id).collect::<Vec<_>>(), [&unread, &sound], "{text}");
        let error = listed[0].pipeline().unwrap_err();
        assert!(error.kind() == Kind::Precondition && error.message().contains(unread.as_str()), "{error}");
        assert!(listed[1].pipeline().is_ok());
    }
    assert!(store.pause_schedule(&unread, true, None).await.unwrap().paused);
    assert_eq!(store.running_schedules().await.unwrap().len(), 1);
    store.delete_schedule(&unread).await.unwrap();
}
