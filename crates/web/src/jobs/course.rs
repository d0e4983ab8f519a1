//! The progress of a job: the part of its page that is refreshed while it runs.

use axum::{extract::Path, response::IntoResponse as _};
use gleaner_core::{
    Result,
    id::JobId,
    job::{Job, JobState, Metric},
    placement::Placement,
    time::Millis,
};
use maud::{Markup, html};

use super::{curves, log};
use crate::{Backend, link, page_request::PageRequest, refusal::Answer, standing::Standings, text};

/// The engine of the server's own machine.
const LOCAL: &str = "local";
/// The metric of jobs with checkpoints that has the milliseconds of each step.
const MS_PER_STEP: &str = "ms_per_step";
/// Steps from which the present rate is estimated.
const NEWEST_STEPS: usize = 21;
/// Points of a curve: more than its plot has pixels.
const POINTS: u32 = 2000;

/// The part alone.
pub(crate) async fn show(request: PageRequest, Path(id): Path<String>) -> Answer {
    let backend = request.backend();
    let job = backend.job(&JobId::parse("id", &id)?).await?;
    Ok(course(backend, &job).await?.into_response())
}

/// Progress, message, error, curves and log.
pub(super) async fn course(backend: &dyn Backend, job: &Job) -> Result<Markup> {
    let metrics = backend.sparse_metrics(&job.id, POINTS).await?;
    // The rest of the page does not depend on it.
    let text = backend.job_log(&job.id, log::LOOKED_AT).await;
    if let Err(error) = &text {
        tracing::warn!(job.id = %job.id, %error, "a job's log cannot be shown");
    }
    let named = [link::episodes(&job.error), link::episodes(&job.message)].concat();
    let standings = Standings::of(backend, &named).await?;
    let linked = |text: &str| link::text_where(text, |id| standings.has_page(id));
    Ok(html! {
        div #course data-state=(job.state.as_str()) {
            (standing(job, linked(&job.message), &metrics, Millis::now()))
            @if !job.error.is_empty() { p.note.bad role="alert" { (linked(&job.error)) } }
            (panels(&metrics))
        }
        (log::newest(&job.id, &text))
    })
}

fn standing(job: &Job, message: Markup, metrics: &[Metric], now: Millis) -> Markup {
    html! {
        div.panel.standing {
            div.row {
                (state(job))
                @if job.total > 0 {
                    progress value=(job.done.min(job.total)) max=(job.total) aria-label="Progress" {}
                    span { (text::count(job.done)) " of " (text::count(job.total)) }
                    span.soft { (text::share(job.done, job.total)) }
                }
                @if let Some(left) = left(job, metrics, now) { span.soft { "about " (text::seconds(left)) " left" } }
            }
            @if !job.message.is_empty() { p.message { (message) } }
            dl.facts.settings {
                div { dt { "Submitted" } dd { (text::time(job.created_at)) " UTC" } }
                @if let Some(started) = job.started_at { div { dt { "Newest attempt" } dd { (text::time(started)) " UTC" } } }
                @if let Some(took) = took(job, now) {
                    div { dt { @if job.state.ended() { "Took" } @else { "Running for" } } dd { (text::seconds(took)) } }
                }
                div { dt { "Attempts" } dd { (job.attempt) " of " (job.max_attempts) } }
                (place(&job.placement))
                @if !job.waiting().is_empty() { div { dt { "Waiting" } dd { (job.waiting()) } } }
                @if job.peak_memory_bytes > 0 { div { dt { "Peak memory" } dd { (text::bytes(job.peak_memory_bytes)) } } }
                @if let Some(step) = job.checkpoint_step { div { dt { "Checkpoint" } dd { "after step " (text::count(step)) } } }
            }
        }
    }
}

/// Where it runs, if not on the server's machine.
fn place(placement: &Placement) -> Markup {
    let Placement { engine, engine_id, node, waiting: _ } = placement;
    html! {
        @if !engine.is_empty() && engine != LOCAL {
            div { dt { "Engine" } dd { (engine) @if !engine_id.is_empty() { " job " span.id { (engine_id) } } } }
            @if !node.is_empty() { div { dt { "Node" } dd { (node) } } }
        }
    }
}

/// Its state, as a tag.
pub(crate) fn state(job: &Job) -> Markup {
    let text = if job.state == JobState::Running && job.cancel_requested { "cancelling" } else { job.state.as_str() };
    html! { span class=(format!("tag {}", job.state.as_str())) { (text) } }
}

/// Seconds since its newest attempt began, until its end or now.
fn took(job: &Job, now: Millis) -> Option<f64> {
    let until = job.ended_at.or_else(|| (job.state == JobState::Running).then_some(now))?;
    Some(seconds(job.started_at?, until))
}

/// The estimated remaining seconds at the present rate.
#[expect(clippy::cast_precision_loss, reason = "for reading")]
fn left(job: &Job, metrics: &[Metric], now: Millis) -> Option<f64> {
    let (done, total) = (job.done as f64, job.total as f64);
    let running = job.state == JobState::Running && done > 0.0 && done < total;
    let took = took(job, now).filter(|took| running && *took > 2.0)?;
    let per_step = match job.checkpoint_step {
        None => took / done,
        // The steps up to a checkpoint may be those of an earlier attempt, whose time is not counted.
        Some(_) => seconds_per_step(metrics)?,
    };
    Some(per_step * (total - done))
}

/// The median of the newest steps that are known: a step with a validation takes longer.
fn seconds_per_step(metrics: &[Metric]) -> Option<f64> {
    let times = metrics.iter().rev().filter(|metric| metric.name == MS_PER_STEP).take(NEWEST_STEPS);
    let mut times: Vec<f64> = times.map(|metric| metric.value / 1000.0).collect();
    times.sort_by(f64::total_cmp);
    times.get(times.len() / 2).copied()
}

#[expect(clippy::cast_precision_loss, reason = "for reading")]
fn seconds(from: Millis, until: Millis) -> f64 {
    until.0.saturating_sub(from.0).max(0) as f64 / 1000.0
}

fn panels(metrics: &[Metric]) -> Markup {
    let families = curves::families(metrics);
    html! {
        @if !families.is_empty() {
            h2 { "Curves" }
            div.curves { @for family in &families { (curves::panel(family)) } }
        }
    }
}

#[cfg(test)]
mod tests {
    use gleaner_core::{
        id::{DatasetId, TaskId},
        job::JobSpec,
    };

    use super::*;

    fn running() -> Job {
        Job {
            id: JobId::new(),
            task_id: TaskId::new(),
            spec: JobSpec::Export { dataset_id: DatasetId::new(), spec: Default::default() },
            state: JobState::Running,
            priority: 0,
            result_id: String::new(),
            done: 25,
            total: 100,
            message: "writing <files>".into(),
            error: String::new(),
            attempt: 1,
            max_attempts: 3,
            placement: Placement::default(),
            cancel_requested: false,
            checkpoint: None,
            checkpoint_step: None,
            peak_memory_bytes: 0,
            needs: Vec::new(),
            waits_for: Vec::new(),
            key: String::new(),
            engine_options: String::new(),
            created_at: Millis(0),
            started_at: Some(Millis(1000)),
            ended_at: None,
        }
    }

    #[test]
    fn the_remaining_time_is_estimated_from_progress() {
        let now = Millis(11_000);
        let left = |job: &Job, now| left(job, &[], now);
        assert_eq!((took(&running(), now), left(&running(), now)), (Some(10.0), Some(30.0)));
        assert_eq!(left(&running(), Millis(2000)), None, "too early to say");
        let ended = Job { state: JobState::Succeeded, ended_at: Some(Millis(6000)), ..running() };
        assert_eq!((took(&ended, now), left(&ended, now)), (Some(5.0), None));
        let queued = Job { state: JobState::Queued, started_at: None, done: 0, total: 0, ..running() };
        assert_eq!((took(&queued, now), left(&queued, now)), (None, None));
    }

    /// An attempt that was stopped does not count, so that its successor is the first one again.
    #[test]
    fn steps_of_an_earlier_attempt_do_not_shorten_the_remaining_time() {
        let metric = |name: &str, value| Metric { sequence: 0, step: 25, name: name.into(), value };
        let metrics = [1900.0, 2000.0, 60_000.0].map(|ms| metric(MS_PER_STEP, ms));
        let metrics = [&metrics[..], &[metric("loss", 0.5)]].concat();
        for attempt in [1, 2] {
            let resumed = Job { attempt, checkpoint_step: Some(24), ..running() };
            assert_eq!(left(&resumed, &metrics, Millis(11_000)), Some(150.0));
            assert_eq!(left(&resumed, &[], Millis(11_000)), None, "no rate is known");
        }
        let again = Job { attempt: 2, ..running() };
        assert_eq!(
            left(&again, &metrics, Millis(11_000)),
            Some(30.0),
            "an attempt without a checkpoint begins at zero"
        );
    }

    #[test]
    fn the_place_of_a_job_on_a_cluster_is_shown() {
        let text = |text: &str| text.to_owned();
        let waits = Placement {
            engine: text("slurm"),
            engine_id: text("17"),
            waiting: text("Resources <x>"),
            ..Placement::default()
        };
        let shown = standing(&Job { placement: waits.clone(), ..running() }, html! {}, &[], Millis(2000)).into_string();
        for part in ["slurm", "17", "Resources &lt;x&gt;"] {
            assert!(shown.contains(part), "{shown}");
        }
        let runs = Placement { node: text("node1"), waiting: String::new(), ..waits };
        let shown = standing(&Job { placement: runs, ..running() }, html! {}, &[], Millis(2000)).into_string();
        assert!(shown.contains("node1") && !shown.contains("Waiting"), "{shown}");
        let local = Placement { engine: text(LOCAL), engine_id: text("4711"), ..Placement::default() };
        let shown = standing(&Job { placement: local, ..running() }, html! {}, &[], Millis(2000)).into_string();
        assert!(!shown.contains("Engine") && !shown.contains("4711"), "{shown}");
    }

    #[test]
    fn the_state_and_message_are_shown_as_text() {
        let text =
            standing(&Job { cancel_requested: true, ..running() }, link::text(&running().message), &[], Millis(2000))
                .into_string();
        assert!(
            text.contains(">cancelling<") && text.contains("writing &lt;files&gt;") && text.contains("25.0 %"),
            "{text}"
        );
    }
}
