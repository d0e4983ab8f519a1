//! `pretrain`, `score`, `train`: one job each.

use clap::Args;
use gleaner_client::Client;
use gleaner_core::arguments::{Given, Pretrain, Score, Train};
use gleaner_core::proto::to_struct;
use gleaner_proto::v1::job_spec::Spec;
use gleaner_proto::v1::train_spec::Data;
use gleaner_proto::v1::{GetDatasetRequest, Job, JobKind, JobSpec, ScoreSpec, SubmitJobRequest, TrainSpec};

use super::plan::SnapshotArgs;
use super::queueing::{JobArgs, SubmitArgs, queued};
use super::{encoder, follow, histogram};
use crate::context::Context;
use crate::failure::{Result, present};
use crate::ids::{self, Kind};
use crate::{json, words};

#[derive(Args, Debug)]
pub(crate) struct PretrainCommand {
    /// Name or id of the task. Default: the only task of the server.
    #[arg(long)]
    task: Option<String>,
    #[command(flatten)]
    snapshot: SnapshotArgs,
    #[command(flatten)]
    settings: Given<Pretrain>,
    #[command(flatten)]
    submit: SubmitArgs,
    #[command(flatten)]
    job: JobArgs,
}

impl PretrainCommand {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        let client = context.client().await?;
        let task = context.task(&client, self.task.as_deref()).await?;
        let submission =
            Submission { task, spec: Spec::Pretrain(self.snapshot.pretrain(&self.settings.values)), job: self.job };
        submission.submit(context, &client, &self.submit).await
    }
}

#[derive(Args, Debug)]
pub(crate) struct ScoreCommand {
    /// Id of the encoder, whose job may be queued. Default: the newest trained one of the task; with --extends, that of the
    /// run. If the task has none and the scorer does not read it, as by default, one of a single step is made first.
    #[arg(long)]
    encoder: Option<String>,
    /// Id of the snapshot to score. Default: the present episodes of the task, under the rule of the encoder's snapshot or,
    /// with --extends, of that run's.
    #[arg(long)]
    snapshot: Option<String>,
    /// Name or id of the task. Default: the encoder's.
    #[arg(long)]
    task: Option<String>,
    /// Extend a finished score run with the episodes that are new since then. Its normaliser and settings are kept.
    #[arg(long, value_name = "RUN", conflicts_with_all = ["scorer", "similarity", "normaliser", "scale", "feature_scale", "local_scale", "lookahead", "progress", "lead_in", "earliness"])]
    extends: Option<String>,
    #[command(flatten)]
    settings: Given<Score>,
    #[command(flatten)]
    submit: SubmitArgs,
    #[command(flatten)]
    job: JobArgs,
}

impl ScoreCommand {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        let client = context.client().await?;
        let (encoder_id, extends) = (self.encoder.unwrap_or_default(), self.extends.unwrap_or_default());
        let task = match [&encoder_id, &extends].into_iter().find(|id| !id.is_empty()) {
            Some(known) => context.task_of_result(&client, self.task.as_deref(), known).await?,
            None => context.task(&client, self.task.as_deref()).await?,
        };
        let settings = Some(to_struct(&self.settings.values));
        // The server chooses an encoder if neither is given.
        let chosen = encoder_id.is_empty() && extends.is_empty();
        let spec = ScoreSpec { encoder_id, snapshot_id: self.snapshot.unwrap_or_default(), extends, settings };
        let submission = Submission { task, spec: Spec::Score(spec), job: self.job };
        let job = submission.queue(context, &client, &self.submit).await?;
        if chosen {
            encoder::note_chosen(context, &client, &job).await?;
        }
        finish(context, &client, job, &self.submit).await
    }
}

#[derive(Args, Debug)]
#[group(id = "data", multiple = false, args = ["dataset", "experts_of", "experts_in"])]
pub(crate) struct TrainCommand {
    /// Id of the dataset; trains on its experts and kept segments. Default: the newest of the task.
    #[arg(long)]
    dataset: Option<String>,
    /// Train on the experts of this encoder's snapshot alone (SSDF-base), instead of a dataset.
    #[arg(long, value_name = "ENCODER")]
    experts_of: Option<String>,
    /// Train on the experts of this snapshot alone, instead of a dataset. For policies that start from scratch.
    #[arg(long, value_name = "SNAPSHOT")]
    experts_in: Option<String>,
    /// Name or id of the task. Default: that of the dataset, encoder or snapshot.
    #[arg(long)]
    task: Option<String>,
    #[command(flatten)]
    settings: Given<Train>,
    #[command(flatten)]
    submit: SubmitArgs,
    #[command(flatten)]
    job: JobArgs,
}

impl TrainCommand {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        let client = context.client().await?;
        let (task, data) = self.data(context, &client).await?;
        if let Data::DatasetId(dataset) = &data {
            encoder::note_unused(context, &client, &task, dataset, &self.settings.values).await?;
        }
        let spec = TrainSpec { data: Some(data), settings: Some(to_struct(&self.settings.values)) };
        let submission = Submission { task, spec: Spec::Train(spec), job: self.job };
        submission.submit(context, &client, &self.submit).await
    }

    // Clap rejects more than one.
    async fn data(&self, context: &Context, client: &Client) -> Result<(String, Data)> {
        if let Some(dataset) = &self.dataset {
            return Ok((task_of_dataset(client, self.task.clone(), dataset).await?, Data::DatasetId(dataset.clone())));
        }
        if let Some(snapshot) = &self.experts_in {
            let task = task_of_snapshot(client, self.task.clone(), snapshot).await?;
            return Ok((task, Data::ExpertsIn(snapshot.clone())));
        }
        if let Some(encoder) = &self.experts_of {
            let task = context.task_of_result(client, self.task.as_deref(), encoder).await?;
            return Ok((task, Data::ExpertsOf(encoder.clone())));
        }
        let dataset = ids::newest(context, client, Kind::Dataset, self.task.as_deref()).await?;
        Ok((task_of_dataset(client, self.task.clone(), &dataset).await?, Data::DatasetId(dataset)))
    }
}

async fn task_of_snapshot(client: &Client, named: Option<String>, snapshot_id: &str) -> Result<String> {
    if let Some(task) = named {
        return Ok(task);
    }
    Ok(client.snapshot(snapshot_id).await?.task_id)
}

/// The task that was named, or the dataset's.
pub(crate) async fn task_of_dataset(client: &Client, named: Option<String>, dataset_id: &str) -> Result<String> {
    if let Some(task) = named {
        return Ok(task);
    }
    let request = GetDatasetRequest { dataset_id: dataset_id.to_owned() };
    let reply = client.datasets().get_dataset(request).await?.into_inner();
    Ok(present(reply.dataset, "a dataset")?.task_id)
}

/// One job to queue.
pub(crate) struct Submission {
    pub(crate) task: String,
    pub(crate) spec: Spec,
    pub(crate) job: JobArgs,
}

impl Submission {
    /// Queues the job, waits for it with --wait, and prints its state.
    pub(crate) async fn submit(self, context: &Context, client: &Client, args: &SubmitArgs) -> Result<()> {
        let job = self.queue(context, client, args).await?;
        finish(context, client, job, args).await
    }

    async fn queue(self, context: &Context, client: &Client, args: &SubmitArgs) -> Result<Job> {
        let request = SubmitJobRequest {
            task: self.task,
            spec: Some(JobSpec { spec: Some(self.spec) }),
            priority: args.priority,
            key: self.job.key.clone(),
            engine_options: self.job.engine.options,
            ..SubmitJobRequest::default()
        };
        queued(context, &self.job.key, client.submit_job(request).await)
    }
}

/// Waits for a queued job with --wait, and prints its state.
async fn finish(context: &Context, client: &Client, mut job: Job, args: &SubmitArgs) -> Result<()> {
    if args.wait {
        job = follow::to_success(context, client, &job.id).await?;
    }
    if args.wait && job.kind() == JobKind::Score {
        histogram::warn(context, client, &job.result_id, 0.0).await;
    }
    context.output.result(|| json::value(&job), || outcome(&job))?;
    context.output.next(if args.wait { after(&job) } else { format!("gleaner watch {}", job.id) });
    Ok(())
}

/// One line on a job: what it is doing or did, and what it makes.
pub(crate) fn outcome(job: &Job) -> String {
    // A job that was cancelled in the queue never began.
    let took = match (&job.start_time, &job.end_time) {
        (Some(start), Some(end)) => format!(" after {}", words::between(Some(start), Some(end))),
        _ => String::new(),
    };
    let (kind, state) = (words::job_kind(job.kind()), words::job_state(job.state()));
    let error = if job.error.is_empty() { String::new() } else { format!(": {}", job.error) };
    let makes = match job.kind() {
        JobKind::Pretrain => "encoder",
        JobKind::Score => "score run",
        JobKind::Train => "policy",
        JobKind::Export => "export",
        JobKind::Evaluate => "evaluation",
        JobKind::Unspecified => "result",
    };
    format!("{kind} job {} {state}{took}{error}; {makes} {}", job.id, job.result_id)
}

/// What one does with a job's result.
pub(crate) fn after(job: &Job) -> String {
    let result = &job.result_id;
    match job.kind() {
        JobKind::Pretrain => format!("gleaner score --scorer ssdf --encoder {result} --wait"),
        JobKind::Score => format!("gleaner histogram {result}"),
        JobKind::Train => format!("gleaner deploy NAME@prod --policy {result}"),
        JobKind::Evaluate => format!("gleaner evaluation {result}"),
        JobKind::Export | JobKind::Unspecified => format!("gleaner job {}", job.id),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gleaner_proto::v1::JobState;

    #[test]
    fn a_job_is_one_line_and_suggests_the_next_command() {
        let at = |seconds| Some(prost_types::Timestamp { seconds, nanos: 0 });
        let job = Job {
            id: "job_1".into(),
            kind: JobKind::Pretrain.into(),
            state: JobState::Succeeded.into(),
            result_id: "enc_1".into(),
            start_time: at(0),
            end_time: at(90),
            ..Job::default()
        };
        assert_eq!(outcome(&job), "pretrain job job_1 succeeded after 1 min 30 s; encoder enc_1");
        assert_eq!(after(&job), "gleaner score --scorer ssdf --encoder enc_1 --wait");
        let cancelled = Job { state: JobState::Cancelled.into(), start_time: None, ..job };
        assert_eq!(outcome(&cancelled), "pretrain job job_1 cancelled; encoder enc_1");
    }
}
