//! Following a job with a progress bar and its latest metrics; where no bar is drawn, by lines.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use gleaner_client::{Client, ClientError};
use gleaner_proto::v1::{GetJobRequest, GetTaskRequest, Job, JobState, ListMetricsRequest, WatchJobResponse};

use super::training_warnings::unseen;

use crate::context::Context;
use crate::failure::{Failure, Result};
use crate::progress::Bar;
use crate::words;

/// Shows a job as it goes.
pub(crate) struct View {
    bar: Bar,
    // Without a bar (a log file, say) each change of state is a line instead, and now and then the progress.
    log: Option<crate::output::Output>,
    state: Option<JobState>,
    pace: Option<Pace>,
    metrics: BTreeMap<String, f64>,
}

impl View {
    pub(crate) fn new(context: &Context, name: &str) -> Self {
        Self {
            bar: context.progress.count(name, 0),
            log: (!context.output.interactive()).then_some(context.output),
            state: None,
            pace: None,
            metrics: BTreeMap::new(),
        }
    }

    pub(crate) fn event(&mut self, event: &WatchJobResponse) {
        for metric in &event.metrics {
            self.metrics.insert(metric.name.clone(), metric.value);
        }
        if let Some(job) = &event.job {
            self.job(job);
        }
    }

    fn job(&mut self, job: &Job) {
        self.bar.set_length(job.total);
        self.bar.set_position(job.done);
        let mut parts = vec![words::job_state(job.state())];
        if !job.message.is_empty() {
            parts.push(job.message.clone());
        }
        if !job.waiting.is_empty() {
            parts.push(format!("waiting: {}", job.waiting));
        }
        parts.extend(latest(&self.metrics));
        self.bar.set_message(&parts.join(" · "));
        if let Some(output) = self.log
            && self.state != Some(job.state())
        {
            let waits = if job.waiting.is_empty() { String::new() } else { format!(", waiting: {}", job.waiting) };
            output.note(format_args!("{} {}{waits}", job.id, words::job_state(job.state())));
        }
        self.state = Some(job.state());
        if let Some((output, line)) = self.log.zip(self.progress(job, Instant::now())) {
            output.note(line);
        }
    }

    /// A line on the progress of a job, if enough has happened since the last one.
    fn progress(&mut self, job: &Job, now: Instant) -> Option<String> {
        let pace = self.pace.get_or_insert(Pace::at(job, now));
        let left = words::time_left(pace.left(job, now)?);
        let loss = latest(&self.metrics).into_iter().next().map_or(String::new(), |loss| format!(", {loss}"));
        Some(format!("{} {}: {} of {}{loss}, {left}", job.id, job.message, job.done, job.total))
    }

    /// Ends the bar, and returns the latest metrics.
    pub(crate) fn end(self) -> BTreeMap<String, f64> {
        self.bar.finish_and_clear();
        self.metrics
    }
}

/// Progress where no bar shows it.
struct Pace {
    /// The part of the work that is followed, its total, and what was done at the first look at it.
    part: (String, u64),
    begun: (Instant, u64),
    /// The time of the last line, and the tenths that were done by then.
    noted: (Instant, u64),
}

/// Shortest time between two lines.
const QUIET: Duration = Duration::from_secs(15);
/// Longest time without a line, whatever has been done since.
const SILENT: Duration = Duration::from_secs(60);

impl Pace {
    fn at(job: &Job, now: Instant) -> Self {
        Self { part: (job.message.clone(), job.total), begun: (now, job.done), noted: (now, tenths(job)) }
    }

    /// The time that the rest of the work takes at the rate so far; `None` between two lines.
    fn left(&mut self, job: &Job, now: Instant) -> Option<Duration> {
        if (job.message.as_str(), job.total) != (self.part.0.as_str(), self.part.1) {
            *self = Self::at(job, now);
        }
        let done = job.done.saturating_sub(self.begun.1);
        let quiet = now - self.noted.0;
        if done == 0 || quiet < QUIET || (tenths(job) <= self.noted.1 && quiet < SILENT) {
            return None;
        }
        self.noted = (now, tenths(job));
        let rest = u32::try_from(job.total.saturating_sub(job.done)).ok()?;
        (now - self.begun.0).checked_mul(rest)?.checked_div(u32::try_from(done).ok()?)
    }
}

/// The tenths of its work that a job has done.
fn tenths(job: &Job) -> u64 {
    (job.done.saturating_mul(10)).checked_div(job.total).unwrap_or(0)
}

// The few that fit on a line: the loss as a whole before its parts, then by name.
fn latest(metrics: &BTreeMap<String, f64>) -> Vec<String> {
    let mut names: Vec<&String> = metrics.keys().collect();
    names.sort_by_key(|name| (name.as_str() != "loss", name.as_str()));
    names.into_iter().take(4).map(|name| format!("{name} {:.4}", metrics[name])).collect()
}

/// Waits until a job has succeeded.
pub(crate) async fn to_success(context: &Context, client: &Client, job_id: &str) -> Result<Job> {
    let job = to_end(context, client, job_id).await?;
    if job.state() == JobState::Succeeded {
        return Ok(job);
    }
    Err(Failure::Client(ClientError::JobEnded(Box::new(job))))
}

/// Waits until a job has ended, however it ends.
pub(crate) async fn to_end(context: &Context, client: &Client, job_id: &str) -> Result<Job> {
    let mut view = View::new(context, job_id);
    let ended = client.watch(job_id, |event| view.event(event)).await;
    let metrics = view.end();
    let job = ended?;
    warn(context, client, &job, &metrics).await?;
    Ok(job)
}

/// Notes what the latest metrics of a training warn of.
async fn warn(context: &Context, client: &Client, job: &Job, metrics: &BTreeMap<String, f64>) -> Result<()> {
    if unseen(metrics, &[], job.total).is_some() {
        let request = GetTaskRequest { task: job.task_id.clone() };
        let task = client.tasks().get_task(request).await?.into_inner().task;
        let cameras = task.and_then(|task| task.spec).map(|spec| spec.cameras).unwrap_or_default();
        let cameras: Vec<String> = cameras.into_iter().map(|camera| camera.name).collect();
        if let Some(warning) = unseen(metrics, &cameras, job.total) {
            context.output.note(format_args!("warning: {warning}"));
        }
    }
    Ok(())
}

/// Notes what the training of a policy warned of.
pub(super) async fn warn_of(context: &Context, client: &Client, task: &str, policy: &str) -> Result<()> {
    let known = client.every_policy(task).await?.policies;
    let Some(job_id) = known.into_iter().find(|known| known.id == policy).map(|known| known.job_id) else {
        return Ok(());
    };
    if job_id.is_empty() {
        return Ok(());
    }
    let request = GetJobRequest { job_id: job_id.clone() };
    let job = client.jobs().get_job(request).await?.into_inner().job.unwrap_or_default();
    let metrics = client.jobs().list_metrics(ListMetricsRequest { job_id }).await?.into_inner().metrics;
    let last = metrics.into_iter().map(|metric| (metric.name, metric.value)).collect();
    warn(context, client, &job, &last).await
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_loss_comes_first_and_four_metrics_fit() {
        let names = ["aa", "loss", "loss_mtp", "ms_per_step", "zz"];
        let metrics = names.iter().map(|name| ((*name).to_owned(), 0.5)).collect();
        assert_eq!(latest(&metrics), ["loss 0.5000", "aa 0.5000", "loss_mtp 0.5000", "ms_per_step 0.5000"]);
    }

    #[test]
    fn without_a_bar_each_tenth_and_each_minute_is_a_line_unless_the_last_is_recent() {
        let bar = Bar::hidden();
        let mut view =
            View { bar, log: None, state: None, pace: None, metrics: BTreeMap::from([("loss".into(), 0.5)]) };
        let begun = Instant::now();
        let mut at = |seconds, message: &str, done| {
            let job = Job { id: "job_1".into(), message: message.into(), done, total: 100, ..Job::default() };
            view.progress(&job, begun + Duration::from_secs(seconds))
        };
        assert_eq!(at(0, "reading episodes", 40), None);
        assert_eq!(at(90, "training", 10), None, "how fast it trains is not known yet");
        assert_eq!(at(95, "training", 20), None, "a short job is followed without a line");
        let line = at(110, "training", 30).unwrap();
        assert_eq!(line, "job_1 training: 30 of 100, loss 0.5000, about 1 min 10 s left");
        assert_eq!(at(140, "training", 39), None, "the same tenth");
        assert!(at(150, "training", 40).unwrap().ends_with("about 2 min 00 s left"));
        assert!(at(210, "training", 41).unwrap().contains(": 41 of 100"), "a minute has gone by");
        assert!(at(230, "training", 100).unwrap().ends_with("100 of 100, loss 0.5000, almost done"));
    }
}
