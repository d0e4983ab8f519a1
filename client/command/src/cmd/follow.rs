//! Following a job with a progress bar and its latest metrics.

use std::collections::BTreeMap;

use gleaner_client::{Client, ClientError};
use gleaner_proto::v1::{Job, JobState, WatchJobResponse};

use crate::context::Context;
use crate::failure::{Failure, Result};
use crate::progress::Bar;
use crate::words;

/// Shows a job as it goes.
pub(crate) struct View {
    bar: Bar,
    // Without a bar (a log file, say) each change of state is a line instead.
    log: Option<crate::output::Output>,
    state: Option<JobState>,
    metrics: BTreeMap<String, f64>,
}

impl View {
    pub(crate) fn new(context: &Context, name: &str) -> Self {
        Self {
            bar: context.progress.count(name, 0),
            log: (!context.output.interactive()).then_some(context.output),
            state: None,
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
    }

    pub(crate) fn end(self) {
        self.bar.finish_and_clear();
    }
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
    view.end();
    Ok(ended?)
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
}
