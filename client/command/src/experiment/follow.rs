//! Waiting for every job, with a line on finished and running jobs and the time left.

use std::collections::{BTreeMap, HashMap};
use std::time::Duration;

use futures::StreamExt as _;
use gleaner_client::{Client, has_ended};
use gleaner_proto::v1::{Job, JobState};

use super::stage::Graph;
use super::standing::Submitted;
use crate::context::Context;
use crate::failure::Result;
use crate::progress::Bar;
use crate::words;

// Jobs run in the order of their submission, so that running jobs are among the first that have not ended.
const WATCHED: usize = 8;

/// Waits until every job has ended, however it ends, and puts each as it then is in its place; after each, `on_end`
/// is called with all of them.
pub(crate) async fn to_the_end(
    context: &Context,
    client: &Client,
    graph: &Graph,
    submitted: &mut Submitted,
    mut on_end: impl AsyncFnMut(&Submitted),
) -> Result<()> {
    let jobs: Vec<(usize, Job)> = (0..)
        .zip(submitted.iter())
        .filter_map(|(index, result)| Some((index, result.as_ref().ok()?.job.clone()?)))
        .collect();
    let view = std::sync::Mutex::new(View::new(context, &jobs));
    let watch = |(index, job): (usize, Job)| {
        let (view, graph) = (&view, graph);
        async move {
            if has_ended(job.state()) {
                return Ok((index, job));
            }
            let label = &graph.stages[index].label;
            let shown = |job: &Job| {
                if let Ok(mut view) = view.lock() {
                    view.changed(job, label);
                }
            };
            let ended = client.watch(&job.id, |event| event.job.iter().for_each(shown)).await?;
            Ok::<_, crate::failure::Failure>((index, ended))
        }
    };
    let mut ended = futures::stream::iter(jobs.into_iter().map(watch)).buffered(WATCHED);
    while let Some(job) = ended.next().await {
        let (index, job) = job?;
        if let Ok(mut view) = view.lock() {
            view.ended(&job, &graph.stages[index].label);
        }
        if let Ok(result) = &mut submitted[index] {
            result.job = Some(job);
        }
        on_end(submitted).await;
    }
    Ok(())
}

/// How long the jobs of a kind take, and how many are left.
#[derive(Default)]
struct Durations {
    seconds: f64,
    ended: u32,
    left: u32,
}

struct View {
    bar: Bar,
    output: crate::output::Output,
    total: usize,
    done: usize,
    durations: BTreeMap<i32, Durations>,
    running: HashMap<String, String>,
}

impl View {
    fn new(context: &Context, jobs: &[(usize, Job)]) -> Self {
        let mut durations: BTreeMap<i32, Durations> = BTreeMap::new();
        for (_, job) in jobs {
            durations.entry(job.kind).or_default().left += 1;
        }
        let bar = context.progress.count("stages", jobs.len() as u64);
        Self { bar, output: context.output, total: jobs.len(), done: 0, durations, running: HashMap::new() }
    }

    fn changed(&mut self, job: &Job, label: &str) {
        if job.state() == JobState::Running {
            let kind = words::job_kind(job.kind());
            let message = format!("{kind} {} ({label})", words::percent(job.done, job.total));
            self.running.insert(job.id.clone(), message);
        } else {
            self.running.remove(&job.id);
        }
        let running: Vec<&str> = self.running.values().map(String::as_str).collect();
        self.bar.set_message(&format!("{} {}", running.join(", "), self.time_left()));
    }

    fn ended(&mut self, job: &Job, label: &str) {
        self.done += 1;
        self.running.remove(&job.id);
        let durations = self.durations.entry(job.kind).or_default();
        durations.left = durations.left.saturating_sub(1);
        if let Some(took) = seconds(job).filter(|_| job.state() == JobState::Succeeded) {
            durations.seconds += took;
            durations.ended += 1;
        }
        self.bar.set_position(self.done as u64);
        let state = if job.state() == JobState::Succeeded {
            words::between(job.start_time.as_ref(), job.end_time.as_ref())
        } else {
            format!("{}: {}", words::job_state(job.state()), job.error)
        };
        let line = format!(
            "{}/{} {} {state} ({label}) {}",
            self.done,
            self.total,
            words::job_kind(job.kind()),
            self.time_left()
        );
        if self.output.interactive() {
            self.bar.println(&line);
        } else {
            self.output.note(line);
        }
    }

    // From the durations of each kind of job so far; empty while one of the remaining kinds has none.
    fn time_left(&self) -> String {
        let of_kind = |durations: &Durations| match (durations.left, durations.ended) {
            (0, _) => Some(0.0),
            (_, 0) => None,
            (left, ended) => Some(durations.seconds / f64::from(ended) * f64::from(left)),
        };
        let left = self.durations.values().map(of_kind).sum::<Option<f64>>().filter(|left| *left > 0.0);
        left.map_or_else(String::new, |left| format!("· about {} left", words::duration(Duration::from_secs_f64(left))))
    }
}

impl Drop for View {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}

/// From a job's start to its end.
pub(crate) fn seconds(job: &Job) -> Option<f64> {
    let (start, end) = (words::timestamp(job.start_time.as_ref())?, words::timestamp(job.end_time.as_ref())?);
    Some(end.duration_since(start).as_secs_f64())
}

#[cfg(test)]
mod tests {
    use super::*;
    use gleaner_proto::v1::JobKind;

    #[test]
    fn the_time_left_is_known_once_each_kind_has_been_seen() {
        let durations = |seconds, ended, left| Durations { seconds, ended, left };
        let view = |pretrain, train| View {
            bar: Bar::hidden(),
            output: crate::output::Output::new(true),
            total: 4,
            done: 2,
            durations: BTreeMap::from([(JobKind::Pretrain.into(), pretrain), (JobKind::Train.into(), train)]),
            running: HashMap::new(),
        };
        assert_eq!(view(durations(20.0, 2, 1), durations(0.0, 0, 1)).time_left(), "");
        assert_eq!(view(durations(20.0, 2, 1), durations(60.0, 1, 2)).time_left(), "· about 2 min 10 s left");
        assert_eq!(view(durations(20.0, 2, 0), durations(60.0, 1, 0)).time_left(), "");
    }
}
