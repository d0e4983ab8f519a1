//! Schedules start when due, once, and store the reason when they cannot.

use gleaner_core::TrainSpec;

use super::*;
use crate::{
    domain::{episode::Outcome, id::ScheduleId, order::JobFilter, schedule::PipelineSpec},
    jobs::testing::{Bench, pipeline},
    store::testing,
};

fn schedule(bench: &Bench, trigger: Trigger, next_run_at: Option<Millis>) -> Schedule {
    Schedule {
        id: ScheduleId::new(),
        task_id: bench.task.id.clone(),
        name: format!("{trigger:?}"),
        trigger,
        pipeline: Ok(PipelineSpec { train: Some(TrainSpec::default()), ..pipeline() }),
        engine_options: String::new(),
        paused: false,
        next_run_at,
        last_run_at: None,
        label_mark: 0,
        labelled_since: 0,
        last_error: String::new(),
    }
}

async fn jobs(jobs: &Jobs) -> usize {
    jobs.0.store.jobs(&JobFilter::default(), None, 100).await.unwrap().0.len()
}

#[tokio::test]
async fn cron_starts_once_when_due_and_moves_on() {
    let bench = Bench::new().await;
    // Stopped, so that the scheduler's own task does not run in between.
    bench.jobs.stop().await;
    let hour = 3_600_000;
    let nightly = schedule(&bench, Trigger::Cron("0 * * * *".into()), Some(Millis(hour)));
    let id = bench.store.insert_schedule(&nightly).await.unwrap().id;
    let due = |now| start_due(&bench.jobs.0, Millis(now));
    assert_eq!(due(hour - 1).await.unwrap(), Some(Millis(hour)));
    assert_eq!(jobs(&bench.jobs).await, 0);
    // Two hours late: made up for once.
    assert_eq!(due(3 * hour + 5).await.unwrap(), Some(Millis(4 * hour)));
    assert_eq!(jobs(&bench.jobs).await, 3);
    assert_eq!(due(3 * hour + 5).await.unwrap(), Some(Millis(4 * hour)));
    assert_eq!(jobs(&bench.jobs).await, 3);
    assert_eq!(bench.store.schedule(&id).await.unwrap().last_run_at, Some(Millis(3 * hour + 5)));

    let paused = bench.jobs.pause_schedule(&id, true).await.unwrap();
    assert_eq!((paused.paused, paused.next_run_at), (true, None));
    assert_eq!(due(9 * hour).await.unwrap(), None);
    assert_eq!(jobs(&bench.jobs).await, 3);
    assert!(bench.jobs.pause_schedule(&id, false).await.unwrap().next_run_at.is_some());
}

#[tokio::test]
async fn a_failed_start_keeps_its_reason_and_its_count() {
    let bench = Bench::empty().await;
    bench.jobs.stop().await;
    let often = schedule(&bench, Trigger::LabelledEpisodes(1), None);
    let id = bench.store.insert_schedule(&often).await.unwrap().id;
    let outcome = Outcome::Success;
    testing::episode(&bench.store, &bench.task, outcome, "").await;
    start_due(&bench.jobs.0, Millis(1)).await.unwrap();
    let failed = bench.store.schedule(&id).await.unwrap();
    assert!(failed.last_error.contains("imperfect"), "{:?}", failed.last_error);
    assert_eq!((failed.labelled_since, jobs(&bench.jobs).await), (1, 0));

    let outcome = Outcome::Failure;
    testing::episode(&bench.store, &bench.task, outcome, "").await;
    start_due(&bench.jobs.0, Millis(2)).await.unwrap();
    let started = bench.store.schedule(&id).await.unwrap();
    assert_eq!((started.labelled_since, started.last_error.as_str(), jobs(&bench.jobs).await), (0, "", 3));
}

#[tokio::test]
async fn options_of_an_engine_are_for_an_engine_that_has_some() {
    let bench = Bench::new().await;
    bench.jobs.stop().await;
    let often = schedule(&bench, Trigger::LabelledEpisodes(1), None);
    let often = Schedule { engine_options: "--partition=gpu".to_owned(), ..often };
    let refused = bench.jobs.add_schedule(&often).await.unwrap_err();
    assert!(refused.message().starts_with("engine_options: this server runs jobs by the engine local"), "{refused}");
    // Made while the server ran jobs by another engine.
    let id = bench.store.insert_schedule(&often).await.unwrap().id;
    testing::episode(&bench.store, &bench.task, Outcome::Success, "").await;
    start_due(&bench.jobs.0, Millis(1)).await.unwrap();
    let failed = bench.store.schedule(&id).await.unwrap();
    assert!(failed.last_error.starts_with("engine_options: "), "{:?}", failed.last_error);
}

#[tokio::test]
async fn a_label_wakes_the_scheduler() {
    let bench = Bench::new().await;
    let often = schedule(&bench, Trigger::LabelledEpisodes(1), None);
    bench.jobs.add_schedule(&often).await.unwrap();
    let mut changed = bench.jobs.0.changed.subscribe();
    let outcome = Outcome::Success;
    testing::episode(&bench.store, &bench.task, outcome, "").await;
    bench.jobs.labelled();
    changed.changed().await.unwrap();
    assert_eq!(jobs(&bench.jobs).await, 3);
    bench.jobs.stop().await;
}

/// Its expression was accepted by an earlier version, say.
#[tokio::test]
async fn a_schedule_that_cannot_start_does_not_stop_the_others() {
    let bench = Bench::new().await;
    bench.jobs.stop().await;
    let wrong = schedule(&bench, Trigger::Cron("at night".into()), Some(Millis(1)));
    let wrong = bench.store.insert_schedule(&wrong).await.unwrap().id;
    let sound = schedule(&bench, Trigger::Cron("0 * * * *".into()), Some(Millis(1)));
    bench.store.insert_schedule(&sound).await.unwrap();
    assert_eq!(start_due(&bench.jobs.0, Millis(2)).await.unwrap(), Some(Millis(3_600_000)));
    assert_eq!(jobs(&bench.jobs).await, 3);
    let wrong = bench.store.schedule(&wrong).await.unwrap();
    assert!(wrong.last_error.starts_with("cron: ") && wrong.next_run_at.is_none(), "{wrong:?}");
}

#[tokio::test]
async fn a_clock_that_was_years_ahead_stops_no_schedule_and_a_correction_repeats_no_start() {
    let bench = Bench::new().await;
    bench.jobs.stop().await;
    let (hour, years) = (3_600_000, 100_000 * 3_600_000);
    // Made while the clock was ahead.
    let hourly = schedule(&bench, Trigger::Cron("0 * * * *".into()), Some(Millis(years)));
    bench.store.insert_schedule(&hourly).await.unwrap();
    let due = async |now, next, count| {
        assert_eq!(start_due(&bench.jobs.0, Millis(now)).await.unwrap(), Some(Millis(next)));
        assert_eq!(jobs(&bench.jobs).await, count, "{now}");
    };
    due(5, hour, 0).await;
    due(hour + 1, 2 * hour, 3).await;
    due(hour - 500, 2 * hour, 3).await;
    // Started while it was ahead.
    due(years + 1, years + hour, 6).await;
    due(2 * hour + 7, 3 * hour, 6).await;
    due(3 * hour, 4 * hour, 9).await;
}

/// Its row is damaged, or a newer version wrote it.
#[tokio::test]
async fn a_schedule_that_cannot_be_read_does_not_start_and_does_not_stop_the_others() {
    let bench = Bench::new().await;
    bench.jobs.stop().await;
    let mut unread = Vec::new();
    for trigger in [Trigger::Cron("0 * * * *".into()), Trigger::LabelledEpisodes(1)] {
        let next = trigger.next_run("cron", Millis(0)).unwrap();
        unread.push(bench.store.insert_schedule(&schedule(&bench, trigger, next)).await.unwrap().id);
    }
    testing::run(&bench.store, "update schedules set pipeline = '{}'").await;
    testing::episode(&bench.store, &bench.task, Outcome::Success, "").await;
    let hour = 3_600_000;
    let sound =
        Schedule { name: "sound".into(), ..schedule(&bench, Trigger::Cron("0 * * * *".into()), Some(Millis(hour))) };
    let sound = bench.store.insert_schedule(&sound).await.unwrap().id;
    assert_eq!(start_due(&bench.jobs.0, Millis(hour)).await.unwrap(), Some(Millis(2 * hour)));
    assert_eq!(jobs(&bench.jobs).await, 3);
    assert_eq!(bench.store.schedule(&sound).await.unwrap().last_error, "");
    for id in &unread {
        let unread = bench.store.schedule(id).await.unwrap();
        assert!(unread.last_error.contains("cannot be read"), "{unread:?}");
        assert_eq!(unread.last_run_at, None);
    }
    assert_eq!(bench.store.schedule(&unread[0]).await.unwrap().next_run_at, Some(Millis(2 * hour)));
}

#[tokio::test]
async fn a_schedule_whose_pipeline_could_never_start_is_refused() {
    let bench = Bench::new().await;
    let mut never = schedule(&bench, Trigger::LabelledEpisodes(1), None);
    never.pipeline.as_mut().unwrap().evaluate = Some(gleaner_core::EvaluateSpec::default());
    let refused = bench.jobs.add_schedule(&never).await.unwrap_err();
    assert_eq!(refused.kind(), crate::error::Kind::Invalid);
    assert!(refused.message().starts_with("pipeline.evaluate.settings.simulation: "), "{refused}");
    never.pipeline.as_mut().unwrap().evaluate = None;
    never.pipeline.as_mut().unwrap().pretrain.image_weights = "absent.safetensors".to_owned().try_into().unwrap();
    let refused = bench.jobs.add_schedule(&never).await.unwrap_err();
    assert!(refused.message().starts_with("image_weights: "), "{refused}");
    assert!(bench.store.running_schedules().await.unwrap().is_empty());
}
