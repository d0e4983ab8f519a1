//! Waiting for every job: a bar with the running jobs and the time left, or lines where no bar is drawn.

use std::collections::{BTreeMap, HashMap};
use std::ops::ControlFlow;
use std::time::{Duration, Instant};

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
/// Shortest time between two lines on the progress of a job.
const QUIET: Duration = Duration::from_secs(15);

/// Waits until every job has ended, however it ends, and puts each as it then is in its place.
pub(crate) async fn to_the_end(context: &Context, client: &Client, graph: &Graph, jobs: &mut Submitted) -> Result<()> {
    until(context, client, graph, jobs, async |_: &Submitted| ControlFlow::Continue(())).await
}

/// As [`to_the_end`]; after each end `on_end` is called with all jobs, and may end the waiting.
pub(crate) async fn until(
    context: &Context,
    client: &Client,
    graph: &Graph,
    submitted: &mut Submitted,
    mut on_end: impl AsyncFnMut(&Submitted) -> ControlFlow<()>,
) -> Result<()> {
    let jobs: Vec<(usize, Job)> = (0..)
        .zip(submitted.iter())
        .filter_map(|(index, result)| Some((index, result.as_ref().ok()?.job.clone()?)))
        .collect();
    let view = std::sync::Mutex::new(View::new(context, &jobs));
    let watch = |(index, job): (usize, Job)| {
        let (view, graph) = (&view, graph);
        async move {
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
    // Each as soon as it ends: a job that waits for its place on a cluster does not delay the others.
    let left = jobs.into_iter().filter(|(_, job)| !has_ended(job.state()));
    let mut ended = futures::stream::iter(left.map(watch)).buffer_unordered(WATCHED);
    while let Some(job) = ended.next().await {
        let (index, job) = job?;
        if let Ok(mut view) = view.lock() {
            view.ended(&job, &graph.stages[index].label);
        }
        if let Ok(result) = &mut submitted[index] {
            result.job = Some(job);
        }
        if on_end(submitted).await.is_break() {
            break;
        }
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

/// What the last line on a job was about.
struct Noted {
    runs: bool,
    waiting: String,
    /// The part of the work, its total and the tenths of it that were done.
    part: (String, u64),
    tenths: u64,
    at: Instant,
}

struct View {
    bar: Bar,
    output: crate::output::Output,
    total: usize,
    done: usize,
    durations: BTreeMap<i32, Durations>,
    /// Of each job that runs or waits for a reason, by its id.
    running: BTreeMap<String, String>,
    noted: HashMap<String, Noted>,
}

impl View {
    /// The jobs that ended before are counted in one line.
    fn new(context: &Context, jobs: &[(usize, Job)]) -> Self {
        let bar = context.progress.count("stages", jobs.len() as u64);
        let (durations, running, noted) = (BTreeMap::new(), BTreeMap::new(), HashMap::new());
        let mut view = Self { bar, output: context.output, total: jobs.len(), done: 0, durations, running, noted };
        for (_, job) in jobs {
            view.durations.entry(job.kind).or_default().left += 1;
        }
        for (_, job) in jobs.iter().filter(|(_, job)| has_ended(job.state())) {
            view.counted(job);
        }
        if (1..view.total).contains(&view.done) {
            view.output.note(format_args!("{} of {} jobs ended before", view.done, view.total));
        }
        view
    }

    fn changed(&mut self, job: &Job, label: &str) {
        let kind = words::job_kind(job.kind());
        if !job.waiting.is_empty() {
            self.running.insert(job.id.clone(), format!("{kind} waiting: {} ({label})", job.waiting));
        } else if job.state() == JobState::Running {
            let message = format!("{kind} {} ({label})", words::percent(job.done, job.total));
            self.running.insert(job.id.clone(), message);
        } else {
            self.running.remove(&job.id);
        }
        let running: Vec<&str> = self.running.values().map(String::as_str).collect();
        self.bar.set_message(&format!("{} {}", running.join(", "), self.time_left()));
        if !self.output.interactive()
            && let Some(line) = self.line(job, label, Instant::now())
        {
            self.output.note(line);
        }
    }

    /// A line on a job where no bar is drawn, if enough has happened since the last one: it runs, it waits for another
    /// reason, or a further tenth of its work is done.
    fn line(&mut self, job: &Job, label: &str, now: Instant) -> Option<String> {
        let kind = words::job_kind(job.kind());
        let (runs, part) = (job.state() == JobState::Running, (job.message.clone(), job.total));
        let tenths = job.done.saturating_mul(10).checked_div(job.total).unwrap_or(0);
        let new = Noted { runs: false, waiting: String::new(), part: part.clone(), tenths, at: now };
        let last = self.noted.entry(job.id.clone()).or_insert(new);
        if last.part != part {
            (last.part, last.tenths) = (part, tenths);
        }
        if last.waiting != job.waiting {
            last.waiting.clone_from(&job.waiting);
            if !job.waiting.is_empty() {
                return Some(format!("{kind} waiting: {} ({label})", job.waiting));
            }
        }
        if !runs || !job.waiting.is_empty() {
            return None;
        }
        if !std::mem::replace(&mut last.runs, true) {
            last.at = now;
            return Some(format!("{kind} running ({label})"));
        }
        if tenths <= last.tenths || now - last.at < QUIET {
            return None;
        }
        (last.tenths, last.at) = (tenths, now);
        let Job { message, done, total, .. } = job;
        let work = format!("{kind} {message}");
        Some(format!("{}: {done} of {total} ({label}) {}", work.trim_end(), self.time_left()))
    }

    /// Counts a job that has ended.
    fn counted(&mut self, job: &Job) {
        self.done += 1;
        let durations = self.durations.entry(job.kind).or_default();
        durations.left = durations.left.saturating_sub(1);
        if let Some(took) = seconds(job).filter(|_| job.state() == JobState::Succeeded) {
            durations.seconds += took;
            durations.ended += 1;
        }
        self.bar.set_position(self.done as u64);
    }

    fn ended(&mut self, job: &Job, label: &str) {
        self.counted(job);
        self.running.remove(&job.id);
        self.noted.remove(&job.id);
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
        left.map_or_else(String::new, |left| format!("· {}", words::time_left(Duration::from_secs_f64(left))))
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

    fn view(durations: BTreeMap<i32, Durations>) -> View {
        let (bar, output) = (Bar::hidden(), crate::output::Output::new(true));
        View { bar, output, total: 4, done: 2, durations, running: BTreeMap::new(), noted: HashMap::new() }
    }

    #[test]
    fn the_time_left_is_known_once_each_kind_has_been_seen() {
        let durations = |seconds, ended, left| Durations { seconds, ended, left };
        let view = |pretrain, train| {
            view(BTreeMap::from([(JobKind::Pretrain.into(), pretrain), (JobKind::Train.into(), train)]))
        };
        assert_eq!(view(durations(20.0, 2, 1), durations(0.0, 0, 1)).time_left(), "");
        assert_eq!(view(durations(20.0, 2, 1), durations(60.0, 1, 2)).time_left(), "· about 2 min 10 s left");
        assert_eq!(view(durations(20.0, 2, 0), durations(60.0, 1, 0)).time_left(), "");
        assert_eq!(view(durations(0.04, 2, 1), durations(60.0, 1, 0)).time_left(), "· almost done");
    }

    #[test]
    fn without_a_bar_a_job_has_a_line_when_it_waits_when_it_runs_and_for_each_tenth() {
        let durations = Durations { seconds: 60.0, ended: 1, left: 2 };
        let (mut view, begun) = (view(BTreeMap::from([(JobKind::Score.into(), durations)])), Instant::now());
        let mut at = |second: u64, state: JobState, waiting: &str, message: &str, done: u64| {
            let job = Job {
                id: "job_1".into(),
                kind: JobKind::Score.into(),
                state: state.into(),
                waiting: waiting.into(),
                message: message.into(),
                done,
                total: 100,
                ..Job::default()
            };
            view.line(&job, "raw, seed 0", begun + Duration::from_secs(second))
        };
        let line = |text: &str| Some(text.to_owned());
        assert_eq!(at(0, JobState::Queued, "", "", 0), None);
        assert_eq!(at(1, JobState::Queued, "Resources", "", 0), line("score waiting: Resources (raw, seed 0)"));
        assert_eq!(at(2, JobState::Queued, "Resources", "", 0), None, "the same reason");
        assert_eq!(at(3, JobState::Running, "", "reading", 90), line("score running (raw, seed 0)"));
        assert_eq!(at(5, JobState::Running, "", "scoring", 10), None, "another part of the work");
        assert_eq!(at(9, JobState::Running, "", "scoring", 20), None, "the last line is recent");
        let expected = "score scoring: 30 of 100 (raw, seed 0) · about 2 min 00 s left";
        assert_eq!(at(40, JobState::Running, "", "scoring", 30), line(expected));
        assert_eq!(at(90, JobState::Running, "", "scoring", 39), None, "the same tenth");
    }

    #[test]
    fn jobs_that_ended_before_are_counted() {
        let time = |seconds| Some(prost_types::Timestamp { seconds, nanos: 0 });
        let job = |state: JobState| Job {
            kind: JobKind::Train.into(),
            state: state.into(),
            start_time: time(10),
            end_time: time(40),
            ..Job::default()
        };
        let mut view = view(BTreeMap::from([(JobKind::Train.into(), Durations { seconds: 0.0, ended: 0, left: 3 })]));
        view.counted(&job(JobState::Succeeded));
        view.counted(&job(JobState::Failed));
        assert_eq!((view.done, view.time_left()), (4, "· about 30 s left".to_owned()));
    }
}
