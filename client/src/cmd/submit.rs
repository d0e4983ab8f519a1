//! `pretrain`, `score`, `train`: one job each.

use clap::Args;
use gleaner_client::Client;
use gleaner_proto::v1::job_spec::Spec;
use gleaner_proto::v1::train_spec::Data;
use gleaner_proto::v1::{Device, GetDatasetRequest, Job, JobKind, JobSpec, ScoreSpec, SubmitJobRequest};

use super::follow;
use super::plan::{self, DeviceArg, PretrainArgs, RunArgs};
use crate::context::Context;
use crate::failure::{Result, present};
use crate::{json, words};

/// Options of every submission.
#[derive(Args, Debug)]
pub(crate) struct SubmitArgs {
    /// Wait until the job has ended, showing its progress.
    #[arg(long)]
    pub(crate) wait: bool,
    /// Higher runs first.
    #[arg(long, default_value_t = 0, allow_negative_numbers = true)]
    pub(crate) priority: i32,
}

#[derive(Args, Debug)]
pub(crate) struct PretrainCommand {
    /// The task's name or id; by default the only task there is.
    #[arg(long)]
    task: Option<String>,
    #[command(flatten)]
    pretrain: PretrainArgs,
    #[command(flatten)]
    submit: SubmitArgs,
}

impl PretrainCommand {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        let client = context.client().await?;
        let task = context.task(&client, self.task.as_deref()).await?;
        submit(context, &client, task, Spec::Pretrain(self.pretrain.spec()), &self.submit).await
    }
}

#[derive(Args, Debug)]
pub(crate) struct ScoreCommand {
    /// The encoder, or one that a queued job will make.
    #[arg(long)]
    encoder: String,
    /// Another snapshot than the encoder's own.
    #[arg(long)]
    snapshot: Option<String>,
    /// The task's name or id; by default the encoder's.
    #[arg(long)]
    task: Option<String>,
    /// Where to compute.
    #[arg(long, value_enum, default_value = "cpu")]
    device: DeviceArg,
    #[command(flatten)]
    submit: SubmitArgs,
}

impl ScoreCommand {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        let client = context.client().await?;
        let task = context.task_of_result(&client, self.task.as_deref(), &self.encoder).await?;
        let spec = ScoreSpec {
            encoder_id: self.encoder,
            snapshot_id: self.snapshot.unwrap_or_default(),
            device: Device::from(self.device).into(),
        };
        submit(context, &client, task, Spec::Score(spec), &self.submit).await
    }
}

#[derive(Args, Debug)]
#[group(id = "data", required = true, multiple = false, args = ["dataset", "experts_of"])]
pub(crate) struct TrainCommand {
    /// Train on this dataset's experts and kept segments.
    #[arg(long)]
    dataset: Option<String>,
    /// Train on the experts of this encoder's snapshot alone (SSDF-base).
    #[arg(long, value_name = "ENCODER")]
    experts_of: Option<String>,
    /// The task's name or id; by default that of the dataset or encoder.
    #[arg(long)]
    task: Option<String>,
    /// Weight of the kept segments' loss.
    #[arg(long)]
    lambda: Option<f64>,
    #[command(flatten)]
    run: RunArgs,
    #[command(flatten)]
    submit: SubmitArgs,
}

impl TrainCommand {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        let client = context.client().await?;
        let mut spec = plan::train(self.run.optim(), self.lambda, self.run.seed, self.run.device);
        let task = match (self.dataset, self.experts_of) {
            (Some(dataset), _) => {
                let task = task_of_dataset(&client, self.task, &dataset).await?;
                spec.data = Some(Data::DatasetId(dataset));
                task
            }
            (None, encoder) => {
                let encoder = encoder.unwrap_or_default();
                let task = context.task_of_result(&client, self.task.as_deref(), &encoder).await?;
                spec.data = Some(Data::ExpertsOf(encoder));
                task
            }
        };
        submit(context, &client, task, Spec::Train(spec), &self.submit).await
    }
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

async fn submit(context: &Context, client: &Client, task: String, spec: Spec, args: &SubmitArgs) -> Result<()> {
    let request = SubmitJobRequest {
        task,
        spec: Some(JobSpec { spec: Some(spec) }),
        priority: args.priority,
        needs: Vec::new(),
        max_attempts: None,
    };
    let mut job = present(client.jobs().submit_job(request).await?.into_inner().job, "a job")?;
    if args.wait {
        job = follow::to_success(context, client, &job.id).await?;
    }
    context.output.result(|| json::value(&job), || outcome(&job))?;
    context.output.next(if args.wait { after(&job) } else { format!("gleaner watch {}", job.id) });
    Ok(())
}

/// One line on a job: what it is doing or did, and what it makes.
pub(crate) fn outcome(job: &Job) -> String {
    let took = words::between(job.start_time.as_ref(), job.end_time.as_ref());
    let took = if job.end_time.is_some() { format!(" after {took}") } else { String::new() };
    let (kind, state) = (words::job_kind(job.kind()), words::job_state(job.state()));
    let error = if job.error.is_empty() { String::new() } else { format!(": {}", job.error) };
    let makes = match job.kind() {
        JobKind::Pretrain => "encoder",
        JobKind::Score => "score run",
        JobKind::Train => "policy",
        JobKind::Export => "export",
        JobKind::Unspecified => "result",
    };
    format!("{kind} job {} {state}{took}{error}; {makes} {}", job.id, job.result_id)
}

/// What one does with a job's result.
pub(crate) fn after(job: &Job) -> String {
    let result = &job.result_id;
    match job.kind() {
        JobKind::Pretrain => format!("gleaner score --encoder {result} --wait"),
        JobKind::Score => format!("gleaner histogram {result}"),
        JobKind::Train => format!("gleaner deploy NAME --policy {result}"),
        JobKind::Export | JobKind::Unspecified => format!("gleaner job {}", job.id),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gleaner_proto::v1::JobState;

    #[test]
    fn a_job_reads_in_one_line_and_leads_on() {
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
        assert_eq!(after(&job), "gleaner score --encoder enc_1 --wait");
    }
}
