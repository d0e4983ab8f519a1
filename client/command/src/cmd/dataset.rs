//! `dataset`: create, list, show, stream.

use clap::{Args, Subcommand};
use gleaner_proto::v1::{CreateDatasetRequest, Dataset, GetDatasetRequest, Segment, StreamSegmentsRequest};

use super::histogram;
use super::selection::{SelectionArgs, selected};
use crate::context::Context;
use crate::failure::{Result, present};
use crate::ids::{self, Kind};
use crate::table::Column::{Left, Right};
use crate::table::{facts, table};
use crate::{json, words};

#[derive(Debug, Subcommand)]
pub(crate) enum DatasetCommand {
    /// Create a dataset from a score run: its experts and its best segments.
    Create {
        /// Id of the score run, which may be unfinished. Default: the newest of the task.
        #[arg(long)]
        run: Option<String>,
        /// Name or id of the task, for the default of --run. Default: the only task of the server.
        #[arg(long, conflicts_with = "run")]
        task: Option<String>,
        #[command(flatten)]
        selection: SelectionArgs,
    },
    /// List a task's datasets, newest first.
    List {
        /// Name or id of the task. Default: the only task of the server.
        #[arg(long)]
        task: Option<String>,
    },
    /// Show a dataset and its counts.
    Show {
        /// Id of the dataset.
        id: String,
    },
    /// Print every segment with its weight, one JSON object per line.
    Stream(StreamArgs),
}

#[derive(Args, Debug)]
pub(crate) struct StreamArgs {
    /// Id of the dataset.
    id: String,
    /// Include raw frames as base64. Multiplies the size of the output.
    #[arg(long)]
    frames: bool,
    /// Omit the segments of experts.
    #[arg(long)]
    kept_only: bool,
}

impl DatasetCommand {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        match self {
            Self::Create { run, task, selection } => create(context, (run, task), selection).await,
            Self::List { task } => list(context, task).await,
            Self::Show { id } => show(context, id).await,
            Self::Stream(args) => stream(context, args).await,
        }
    }
}

async fn create(
    context: &Context,
    (run, task): (Option<String>, Option<String>),
    selection: SelectionArgs,
) -> Result<()> {
    let client = context.client().await?;
    let score_run_id = match run {
        Some(run) => run,
        None => ids::newest(context, &client, Kind::Run, task.as_deref()).await?,
    };
    let request = CreateDatasetRequest { score_run_id, selection: Some(selection.to_proto()) };
    let reply = client.datasets().create_dataset(request).await?.into_inner();
    let dataset = present(reply.dataset.as_ref(), "a dataset")?;
    context.output.result(|| json::value(&reply), || describe(dataset))?;
    // A run without counts is unfinished.
    if dataset.kept_segments.is_some() {
        histogram::warn(context, &client, &dataset.score_run_id, selection.shape().min_expert_auroc).await;
    }
    context.output.next(training(&dataset.id));
    Ok(())
}

/// How to train on a dataset.
fn training(dataset: &str) -> String {
    format!("gleaner train --dataset {dataset} --wait")
}

async fn show(context: &Context, id: String) -> Result<()> {
    let request = GetDatasetRequest { dataset_id: id };
    let reply = context.client().await?.datasets().get_dataset(request).await?.into_inner();
    let dataset = present(reply.dataset.as_ref(), "a dataset")?;
    context.output.result(|| json::value(&reply), || describe(dataset))?;
    context.output.next(format_args!("gleaner export {} --format mcap --out DIR", dataset.id));
    Ok(())
}

// Counts are there once the score run is finished.
fn count(count: Option<u64>) -> String {
    count.map_or_else(|| "not yet".into(), |count| count.to_string())
}

fn describe(dataset: &Dataset) -> String {
    facts([
        ("id", dataset.id.clone()),
        ("score run", dataset.score_run_id.clone()),
        ("keeps", selected(dataset.selection.as_ref())),
        ("kept segments", count(dataset.kept_segments)),
        ("from episodes", count(dataset.kept_episodes)),
        ("expert segments", count(dataset.expert_segments)),
        ("created", words::moment(dataset.create_time.as_ref())),
    ])
}

async fn list(context: &Context, task: Option<String>) -> Result<()> {
    let client = context.client().await?;
    let reply = client.every_dataset(&context.task(&client, task.as_deref()).await?).await?;
    let columns = [Left("ID"), Left("SCORE RUN"), Left("KEEPS"), Right("KEPT"), Right("EXPERT"), Left("CREATED")];
    let row = |dataset: &Dataset| {
        [
            dataset.id.clone(),
            dataset.score_run_id.clone(),
            selected(dataset.selection.as_ref()),
            count(dataset.kept_segments),
            count(dataset.expert_segments),
            words::moment(dataset.create_time.as_ref()),
        ]
    };
    context.output.result(|| json::value(&reply), || table(columns, reply.datasets.iter().map(row)))?;
    match reply.datasets.first() {
        Some(dataset) => context.output.next(training(&dataset.id)),
        None => context.output.next("gleaner dataset create --run RUN"),
    }
    Ok(())
}

async fn stream(context: &Context, args: StreamArgs) -> Result<()> {
    let request =
        StreamSegmentsRequest { dataset_id: args.id.clone(), include_frames: args.frames, kept_only: args.kept_only };
    let mut segments = context.client().await?.datasets().stream_segments(request).await?.into_inner();
    let mut count = 0_u64;
    while let Some(message) = segments.message().await? {
        let segment: Segment = present(message.segment, "a segment")?;
        let mut line = json::value(&segment)?;
        if let (false, Some(fields)) = (args.frames, line.as_object_mut()) {
            fields.remove("frames");
        }
        context.output.json_line(&line)?;
        count += 1;
    }
    context.output.note(words::counted(count, "segment", "segments"));
    context.output.next(training(&args.id));
    Ok(())
}
