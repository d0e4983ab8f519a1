//! The scheduler: starts pipelines when their time comes or enough episodes are labelled. Sleeps until then.

use std::{sync::Arc, time::Duration};

use super::{Inner, Jobs};
use crate::{
    domain::{
        order::PipelineQueueing,
        schedule::{Schedule, ScheduleStart, Trigger},
        time::Millis,
    },
    error::Result,
};

/// The longest sleep, because the system's clock may be set in the meantime.
const LONGEST: Duration = Duration::from_secs(600);
/// A clock that is set back by less was not wrong.
const CORRECTION: Duration = Duration::from_secs(60 * 60);

/// Runs schedules until the server stops.
pub(super) async fn schedule(inner: Arc<Inner>) {
    let running = async {
        loop {
            // A notification between the check and the wait is kept as a permit.
            let next = match start_due(&inner, Millis::now()).await {
                Ok(next) => next,
                Err(error) => {
                    tracing::error!(%error, "schedules cannot be read; retrying");
                    None
                }
            };
            // The cause of the wake-up does not matter.
            let _ = tokio::time::timeout(until(next), inner.due.notified()).await;
        }
    };
    inner.stopping.run_until_cancelled(running).await;
}

fn until(next: Option<Millis>) -> Duration {
    let Some(next) = next else { return LONGEST };
    let wait = next.0.saturating_sub(Millis::now().0).max(0);
    Duration::from_millis(u64::try_from(wait).unwrap_or(0)).min(LONGEST)
}

/// Starts every schedule that is due; returns the time at which cron is due next. A schedule whose start fails does not keep
/// those behind it from starting.
async fn start_due(inner: &Arc<Inner>, now: Millis) -> Result<Option<Millis>> {
    let mut next = None;
    for schedule in inner.store.running_schedules().await? {
        let again = if due(&schedule, now) {
            start(inner, &schedule, now).await.unwrap_or_else(|error| {
                tracing::error!(schedule.id = %schedule.id, %error, "a schedule could not start; retrying");
                None
            })
        } else {
            next_start(inner, &schedule, now).await?
        };
        next = next.into_iter().chain(again).min();
    }
    Ok(next)
}

fn due(schedule: &Schedule, now: Millis) -> bool {
    match &schedule.trigger {
        // A time that passed while the server was down is made up for once.
        Trigger::Cron(_) => schedule.next_run_at.is_some_and(|time| time <= now),
        Trigger::LabelledEpisodes(episodes) => schedule.labelled_since >= *episodes,
    }
}

/// When cron starts a schedule that is not due. A time that was stored while the clock was ahead is replaced: the schedule
/// would otherwise wait until the clock gets there again, which may take years.
async fn next_start(inner: &Arc<Inner>, schedule: &Schedule, now: Millis) -> Result<Option<Millis>> {
    let Some(stored) = schedule.next_run_at else { return Ok(None) };
    // An expression that cannot be read is reported when the schedule is due.
    let Ok(Some(next)) = schedule.trigger.next_run("cron", now) else { return Ok(Some(stored)) };
    // A small correction of the clock does not repeat a start.
    let started = schedule.last_run_at.is_some_and(|at| next <= at && at <= now.after(CORRECTION));
    if next >= stored || started {
        return Ok(Some(stored));
    }
    tracing::warn!(schedule.id = %schedule.id, "the clock was ahead when the next start of a schedule was stored");
    inner.store.move_schedule(&schedule.id, next).await?;
    Ok(Some(next))
}

/// Starts one schedule. If it cannot start, the reason is stored in its row. Cron then waits for its next time; a schedule
/// that waits for labels keeps its count and tries again whenever the scheduler wakes: with the next label or change of a
/// schedule, when cron is due, and after [`LONGEST`] at most.
async fn start(inner: &Arc<Inner>, schedule: &Schedule, now: Millis) -> Result<Option<Millis>> {
    let next_run_at = match schedule.trigger.next_run("cron", now) {
        Ok(next) => next,
        // No later time will do: the schedule waits for a person.
        Err(error) => {
            tracing::error!(schedule.id = %schedule.id, %error, "a schedule has no next start");
            inner.store.schedule_failed(&schedule.id, error.message(), None).await?;
            return Ok(None);
        }
    };
    let label_mark = inner.store.newest_label().await?;
    let start = ScheduleStart { id: schedule.id.clone(), at: now, next_run_at, label_mark };
    let jobs = Jobs(Arc::clone(inner));
    let engine_options = schedule.engine_options.clone();
    let queueing = PipelineQueueing { engine_options, ..PipelineQueueing::default() };
    let started = match schedule.pipeline() {
        Ok(pipeline) => jobs.submit_pipeline(&schedule.task_id, pipeline, queueing, Some(start)).await,
        Err(error) => Err(error),
    };
    match started {
        Ok((queued, _)) => tracing::info!(schedule.id = %schedule.id, jobs = queued.len(), "schedule started"),
        Err(error) => {
            tracing::warn!(schedule.id = %schedule.id, %error, "schedule could not start");
            inner.store.schedule_failed(&schedule.id, error.message(), next_run_at).await?;
        }
    }
    Ok(next_run_at)
}

#[cfg(test)]
mod tests;
