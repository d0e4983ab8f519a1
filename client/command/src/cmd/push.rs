//! `push`: recordings with their labels, many at a time.

mod check;
mod cut;
mod datasets;
mod items;
mod join;
mod shown;
mod task_file;

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use clap::Args;
use gleaner_client::{
    Client, ClientError, PushEvent, PushItem, PushResult, Pushed, Skipped, outcome_from_word, read_ranges,
};
use gleaner_inspector::Assumed;
use gleaner_proto::v1::Outcome;

use super::label_table::LabelTableArgs;
use crate::context::Context;
use crate::failure::{Failure, Result};
use crate::intake::{self, Candidate, Intake};
use cut::Marks;
use shown::{document, summary, without_cohort};

#[derive(Args, Debug)]
#[group(id = "what", required = true, multiple = true, args = ["paths", "labels"])]
pub(crate) struct PushArgs {
    /// Recordings, or folders that are searched for *.mcap; files that are not regular, and datasets of other
    /// programs, are skipped and listed. A folder
    /// whose metadata.yaml lists several parts (rosbag2) is one recording. Or datasets of other programs: LeRobot's folder
    /// with meta/info.json, robomimic's *.hdf5, or a folder of them without recordings, in which other HDF5 files are
    /// skipped and listed. Default with --labels: every file that it lists.
    paths: Vec<PathBuf>,
    /// Join parts that a recorder has cut (NAME_0.mcap, NAME_1.mcap, …) to one recording: those in each folder given, or
    /// the files given. A missing part is an error.
    #[arg(long, requires = "paths", conflicts_with = "labels")]
    join: bool,
    /// Cut each recording into episodes at the messages of this topic. A message begins an episode; a text with a word such
    /// as stop, success, failure (or no success) or discard, or a false flag, ends it. Takes disk for the recording once
    /// more. Of a recording that ends in the middle, the last episode is rejected.
    #[arg(long, value_name = "TOPIC", requires = "paths", conflicts_with_all = ["join", "labels", "check"])]
    episodes_from: Option<String>,
    /// Cut one recording into episodes by the times in this file, with the columns start and end (seconds from the first
    /// message), and optionally success (true, false) and name. Takes disk for the recording once more.
    #[arg(long, value_name = "CSV", requires = "paths", conflicts_with_all = ["join", "labels", "check", "episodes_from"])]
    ranges: Option<PathBuf>,
    /// Name or id of the task. Default: that of the labels file, or the only task of the server. A dataset of another
    /// program becomes episodes of the task of its environment or name, which must have its rate, or else of the one that
    /// it fits; if it fits none, a task is created from its features.
    #[arg(long)]
    task: Option<String>,
    /// Task file of the recordings: once all of them have passed the check of `task check`, with their labels, its task is
    /// created unless the server has it, and they are sent. If one would be rejected, nothing is created or sent.
    #[arg(
        long,
        value_name = "SPEC",
        requires = "paths",
        conflicts_with_all = ["task", "check", "join", "episodes_from", "ranges"]
    )]
    task_file: Option<PathBuf>,
    /// Outcome of the attempts, such as success for a dataset of experts. Default: that of the labels file or the dataset,
    /// or unknown.
    #[arg(long, value_parser = outcome_from_word, value_name = "success|failure|unknown")]
    outcome: Option<Outcome>,
    /// Cohort: a free name for a group of episodes, such as a kind of failure, an operator or a policy. Default of a dataset of
    /// another program: its name.
    #[arg(long)]
    cohort: Option<String>,
    /// Steps per second of a dataset of another program that does not state them, such as robomimic's. Default: 20.
    #[arg(long, value_name = "HZ")]
    rate: Option<f64>,
    /// Column of a dataset of another program whose last value in an episode states its outcome: success if it is true or
    /// above 0. Default: next.success of LeRobot's datasets; robomimic's rewards where they are 0 and 1.
    #[arg(long, value_name = "NAME", conflicts_with = "outcome")]
    success_column: Option<String>,
    /// CSV file with the columns file,task,outcome,cohort that labels each recording, by its path from the file, or by its
    /// name or that of its rosbag2 folder where no other has it. A cohort can name the kind of a failure. Default: the
    /// labels.csv in each folder given, unless --outcome or --cohort is given.
    #[arg(long, value_name = "CSV", conflicts_with_all = ["outcome", "cohort"])]
    labels: Option<PathBuf>,
    #[command(flatten)]
    table: LabelTableArgs,
    /// Maximum number of concurrent uploads. More make better use of a fast network; fewer leave bandwidth to others.
    #[arg(long, default_value_t = 4, value_name = "N")]
    jobs: usize,
    /// Check the recordings and send none of their bytes: whether they are stored already, or above a limit of the
    /// server by what they state about themselves. A recording that passes can still be rejected by its inspection.
    #[arg(long)]
    check: bool,
}

impl PushArgs {
    pub(crate) async fn run(mut self, context: &Context) -> Result<()> {
        if let Some(file) = self.task_file.take() {
            let client = context.client().await?;
            self.task = Some(task_file::task(&self, context, &client, &file).await?);
        }
        let (found, others) = intake::split(&self.paths);
        if !found.is_empty() {
            return self.push_datasets(context, &found, &others).await;
        }
        intake::expect_datasets(&found, &self.assumed())?;
        let marks = match (&self.episodes_from, &self.ranges) {
            (Some(topic), _) => Some(Marks::Topic(topic.clone())),
            (None, Some(ranges)) => Some(Marks::Ranges(read_ranges(ranges)?)),
            (None, None) => None,
        };
        if marks.is_some() {
            self.table.refuse("--labels")?;
        }
        let client = context.client().await?;
        if let Some(marks) = &marks {
            let (pushed, skipped, task) = cut::push(&self, context, &client, marks).await?;
            return report(context, &pushed, &skipped, &task);
        }
        let (items, skipped) = items::items(&self, context, &client).await?;
        if self.check {
            intake::note(context, &skipped);
            return check::check(context, &client, items, self.jobs).await;
        }
        let task = items.first().map(|item| item.task.clone()).unwrap_or_default();
        let pushed = push(context, &client, items, self.jobs).await;
        report(context, &pushed, &skipped, &task)
    }

    /// What datasets of other programs do not state.
    fn assumed(&self) -> Assumed {
        Assumed { rate_hz: self.rate, success_column: self.success_column.clone() }
    }

    async fn push_datasets(self, context: &Context, found: &[Candidate], others: &[PathBuf]) -> Result<()> {
        let first = found.first().map(|dataset| dataset.path.display().to_string()).unwrap_or_default();
        if let Some(other) = others.first() {
            let problem = format!("{first} is a dataset of another program and {} is not", other.display());
            return Err(Failure::message(format!("{problem}; push them one after the other")));
        }
        for (flag, given) in [
            ("--join", self.join),
            ("--labels", self.labels.is_some()),
            ("--check", self.check),
            (self.table.given().unwrap_or_default(), self.table.given().is_some()),
            ("--episodes-from", self.episodes_from.is_some()),
            ("--ranges", self.ranges.is_some()),
        ] {
            if given {
                let problem = format!("{flag} does not apply to {first}, a dataset of another program");
                return Err(Failure::message(format!("{problem}; `gleaner task check` checks its episodes")));
            }
        }
        let opened = Intake::open_all(context, found, &self.assumed()).await?;
        let client = context.client().await?;
        let (mut pushed, task) = datasets::push(&self, context, &client, &opened.intakes).await?;
        let refused = opened.refused.into_iter();
        pushed.results.extend(refused.map(|(path, why)| PushResult { path, result: Err(ClientError::Invalid(why)) }));
        report(context, &pushed, &opened.skipped, &task)
    }
}

/// Shows the results; recordings that were rejected are a failure.
fn report(context: &Context, pushed: &Pushed, skipped: &[Skipped], task: &str) -> Result<()> {
    context.output.result(|| document(pushed, skipped), || summary(pushed, skipped))?;
    let failures = pushed.failures().count();
    if failures > 0 {
        return Err(Failure::message(format!(
            "{failures} of {} recordings were rejected; fix them and push them again",
            pushed.results.len()
        )));
    }
    if let Some(hint) = without_cohort(pushed) {
        context.output.note(hint);
    }
    context.output.next(format_args!("gleaner pipeline --task {task} --quick --wait"));
    Ok(())
}

// Bytes of a recording for the progress: those of its parts are about those of their join.
fn size(item: &PushItem) -> u64 {
    let of = |path: &Path| std::fs::metadata(path).map_or(0, |file| file.len());
    match std::fs::read_dir(&item.path) {
        Ok(entries) => entries.flatten().map(|entry| of(&entry.path())).sum(),
        Err(_) if item.parts.is_empty() => of(&item.path),
        Err(_) => item.parts.iter().map(|part| of(part)).sum(),
    }
}

/// Pushes with a progress bar over all bytes.
pub(crate) async fn push(context: &Context, client: &Client, items: Vec<PushItem>, parallel: usize) -> Pushed {
    let sizes: Vec<u64> = items.iter().map(size).collect();
    let bar = context.progress.bytes("push", sizes.iter().sum());
    let sent: Vec<AtomicU64> = sizes.iter().map(|_| AtomicU64::new(0)).collect();
    let drawn = bar.clone();
    let advance = move |item: usize, now: u64| {
        // A resumed upload falls back a little; so may the bar.
        let before = sent[item].swap(now, Ordering::Relaxed);
        if now >= before {
            drawn.inc(now - before);
        } else {
            drawn.dec(before - now);
        }
    };
    let pushed = client
        .push(items, parallel, move |event| match event {
            PushEvent::Sent { item, bytes } => advance(item, bytes),
            PushEvent::Done { item } => advance(item, sizes[item]),
        })
        .await;
    bar.finish_and_clear();
    pushed
}
