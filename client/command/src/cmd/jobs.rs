//! `jobs`, `job`, `watch`, `cancel`.

use std::path::{Path, PathBuf};

use clap::{Args, Subcommand, ValueEnum};
use gleaner_client::{Client, ClientError};
use gleaner_proto::v1::{
    CancelJobRequest, GetJobRequest, Job, JobState, ListJobsRequest, ListJobsResponse, ListMetricsRequest,
    WatchJobResponse,
};

use super::follow;
use super::metrics::{self, curves};
use super::submit::{after, outcome};
use crate::context::Context;
use crate::failure::{Failure, Result, present};
use crate::output::unless_closed;
use crate::table::Column::{Left, Right};
use crate::table::{facts, table};
use crate::{json, words};

#[derive(Clone, Copy, Debug, ValueEnum)]
enum StateArg {
    Queued,
    Running,
    Succeeded,
    Failed,
    Cancelled,
}

impl From<StateArg> for JobState {
    fn from(state: StateArg) -> Self {
        match state {
            StateArg::Queued => Self::Queued,
            StateArg::Running => Self::Running,
            StateArg::Succeeded => Self::Succeeded,
            StateArg::Failed => Self::Failed,
            StateArg::Cancelled => Self::Cancelled,
        }
    }
}

// Not `args_conflicts_with_subcommands`, which would refuse `gleaner jobs --json export`; `help::parse` refuses the rest.
#[derive(Args, Debug)]
pub(crate) struct JobsArgs {
    #[command(subcommand)]
    command: Option<JobsCommand>,
    /// List only jobs of this task.
    #[arg(long, default_value = "", hide_default_value = true)]
    task: String,
    /// List only jobs in this state.
    #[arg(long, value_enum)]
    state: Option<StateArg>,
    /// Maximum number of jobs, 1 to 1000; the newest are listed.
    #[arg(long, default_value_t = 100, value_parser = clap::value_parser!(u32).range(1..=1000))]
    limit: u32,
}

#[derive(Debug, Subcommand)]
enum JobsCommand {
    /// Print every job as a line of JSON, oldest first, with its settings and the last value of each of its metrics.
    Export {
        /// Print only jobs of this task.
        #[arg(long, default_value = "", hide_default_value = true)]
        task: String,
        /// Also write the curves of each job as an event file into a folder of its own in this one, as runs of TensorBoard. A
        /// second run replaces the files.
        #[arg(long, value_name = "DIR")]
        tensorboard: Option<PathBuf>,
    },
}

impl JobsArgs {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        if let Some(JobsCommand::Export { task, tensorboard }) = self.command {
            return export(context, task, tensorboard.as_deref()).await;
        }
        let request = ListJobsRequest {
            task: self.task,
            state: self.state.map(JobState::from).unwrap_or_default().into(),
            page_size: self.limit,
            page_token: String::new(),
        };
        let reply: ListJobsResponse = context.client().await?.jobs().list_jobs(request).await?.into_inner();
        context.output.result(|| json::value(&reply), || listing(&reply.jobs))?;
        // The newest of which there is more to see.
        let open = |job: &&Job| matches!(job.state(), JobState::Queued | JobState::Running);
        match reply.jobs.iter().find(open).or(reply.jobs.first()) {
            Some(job) => context.output.next(next(job)),
            None => context.output.next("gleaner pipeline --quick --wait"),
        }
        Ok(())
    }
}

async fn export(context: &Context, task: String, tensorboard: Option<&Path>) -> Result<()> {
    let client = context.client().await?;
    let mut request = ListJobsRequest { task, page_size: 1000, ..ListJobsRequest::default() };
    let mut jobs: Vec<Job> = Vec::new();
    loop {
        let page = client.jobs().list_jobs(request.clone()).await?.into_inner();
        jobs.extend(page.jobs);
        if page.next_page_token.is_empty() {
            break;
        }
        request.page_token = page.next_page_token;
    }
    // Ids sort by the time at which they were made.
    jobs.sort_by(|one, other| one.id.cmp(&other.id));
    for job in &jobs {
        let read = client.jobs().list_metrics(ListMetricsRequest { job_id: job.id.clone() }).await?.into_inner();
        let mut line = json::value(job)?;
        let last = |(name, points): (&str, Vec<(u64, f64)>)| Some((name.to_owned(), points.last()?.1.into()));
        let last: serde_json::Map<String, serde_json::Value> =
            curves(&read.metrics).into_iter().filter_map(last).collect();
        if let Some(fields) = line.as_object_mut() {
            fields.insert("metrics".to_owned(), last.into());
        }
        if let Some(folder) = tensorboard.filter(|_| !read.metrics.is_empty()) {
            metrics::write(&folder.join(&job.id), job, &read.metrics)?;
        }
        let printed = context.output.json_line(&line);
        // The curves of the other jobs are written although the lines have no reader.
        if tensorboard.is_some() { unless_closed(printed) } else { printed }?;
    }
    if let Some(folder) = tensorboard {
        context.output.next(format_args!("tensorboard --logdir {}", folder.display()));
    }
    Ok(())
}

/// Jobs as a table.
pub(crate) fn listing(jobs: &[Job]) -> String {
    let columns = [
        Left("ID"),
        Left("KIND"),
        Left("STATE"),
        Right("DONE"),
        Right("TOOK"),
        Left("CREATED"),
        Left("MAKES"),
        Left("MESSAGE"),
    ];
    let row = |job: &Job| {
        [
            job.id.clone(),
            words::job_kind(job.kind()),
            words::job_state(job.state()),
            words::percent(job.done, job.total),
            words::between(job.start_time.as_ref(), job.end_time.as_ref()),
            words::moment(job.create_time.as_ref()),
            job.result_id.clone(),
            if job.error.is_empty() { job.message.clone() } else { job.error.clone() },
        ]
    };
    table(columns, jobs.iter().map(row))
}

#[derive(Args, Debug)]
pub(crate) struct JobArgs {
    /// Id of the job.
    id: String,
}

impl JobArgs {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        let request = GetJobRequest { job_id: self.id };
        let reply = context.client().await?.jobs().get_job(request).await?.into_inner();
        let job = present(reply.job.as_ref(), "a job")?;
        context.output.result(|| json::value(&reply), || described(job, &reply.log))?;
        context.output.next(next(job));
        Ok(())
    }
}

fn next(job: &Job) -> String {
    match job.state() {
        JobState::Succeeded => after(job),
        JobState::Queued | JobState::Running | JobState::Unspecified => format!("gleaner watch {}", job.id),
        JobState::Failed | JobState::Cancelled => format!("gleaner jobs (job {} can be submitted again)", job.id),
    }
}

/// The job and its log.
fn described(job: &Job, log: &str) -> String {
    let facts = describe(job);
    if log.is_empty() { facts } else { format!("{facts}\nlog\n{log}") }
}

/// Where its newest attempt runs or ran.
fn place(job: &Job) -> String {
    match (job.engine.as_str(), job.node.as_str()) {
        ("slurm", "") => format!("slurm job {}", job.engine_id),
        ("slurm", node) => format!("slurm job {} on {node}", job.engine_id),
        (engine, _) => engine.to_owned(),
    }
}

fn describe(job: &Job) -> String {
    facts([
        ("id", job.id.clone()),
        ("task", job.task_id.clone()),
        ("kind", words::job_kind(job.kind())),
        ("state", words::job_state(job.state())),
        ("done", format!("{} of {}", job.done, job.total)),
        ("message", job.message.clone()),
        ("error", job.error.clone()),
        ("makes", job.result_id.clone()),
        ("needs", job.needs.join(" ")),
        ("attempt", format!("{} of {}", job.attempt, job.max_attempts)),
        ("engine", place(job)),
        ("engine options", job.engine_options.clone()),
        ("waiting", job.waiting.clone()),
        ("priority", job.priority.to_string()),
        ("created", words::moment(job.create_time.as_ref())),
        ("took", words::between(job.start_time.as_ref(), job.end_time.as_ref())),
        ("peak memory", format!("{:.0} MB", words::megabytes(job.peak_memory_bytes))),
    ])
}

#[derive(Args, Debug)]
pub(crate) struct WatchArgs {
    /// Id of the job.
    id: String,
}

impl WatchArgs {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        let client = context.client().await?;
        let job = if context.output.json() {
            stream(context, &client, &self.id).await?
        } else {
            let job = follow::to_end(context, &client, &self.id).await?;
            context.output.result(|| json::value(&job), || outcome(&job))?;
            job
        };
        if job.state() != JobState::Succeeded {
            return Err(Failure::Client(ClientError::JobEnded(Box::new(job))));
        }
        context.output.next(after(&job));
        Ok(())
    }
}

// Each event as a line of JSON.
async fn stream(context: &Context, client: &Client, job_id: &str) -> Result<Job> {
    let mut printed = Ok(());
    let print = |event: &WatchJobResponse| {
        if printed.is_ok() {
            printed = json::value(event).and_then(|event| context.output.json_line(&event));
        }
    };
    let job = client.watch(job_id, print).await?;
    unless_closed(printed).map(|()| job)
}

#[derive(Args, Debug)]
pub(crate) struct CancelArgs {
    /// Id of the job.
    id: String,
}

impl CancelArgs {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        let request = CancelJobRequest { job_id: self.id };
        let reply = context.client().await?.jobs().cancel_job(request).await?.into_inner();
        let job = present(reply.job.as_ref(), "a job")?;
        context.output.result(|| json::value(&reply), || outcome(job))?;
        context.output.next("gleaner jobs");
        Ok(())
    }
}
