//! Taking orders: inputs are resolved, results get their ids, dependencies are found, and all is queued at once.

use gleaner_learn::ScoreSpec;

use super::Jobs;
use crate::{
    domain::{
        dataset::Dataset,
        id::{DatasetId, EncoderId, ExportId, JobId, PolicyId, ScoreRunId, SnapshotId, TaskId},
        job::{Job, JobSpec},
        order::{JobOrder, NewJob, Plan, Queueing, TrainData},
        schedule::{PipelineSpec, ScheduleStart},
        snapshot::RoleRule,
        time::Millis,
    },
    error::{Error, Result},
};

/// Attempts of a job that does not say how many.
const MAX_ATTEMPTS: u32 = 3;

/// An order with everything chosen.
struct Resolved {
    spec: JobSpec,
    result_id: String,
    /// The job that makes its input, if a job does.
    maker: Option<JobId>,
}

impl Jobs {
    /// Queues a job.
    ///
    /// # Errors
    /// NotFound for what the order names and is not there; Invalid for what belongs to another task;
    /// Precondition when the snapshot would lack a role, or when the maker of an input gave up.
    pub(crate) async fn submit(&self, task: &TaskId, order: JobOrder, queueing: Queueing) -> Result<Job> {
        let resolved = self.resolve(task, order).await?;
        let job = NewJob {
            id: JobId::new(),
            task_id: task.clone(),
            spec: resolved.spec,
            result_id: resolved.result_id,
            priority: queueing.priority,
            max_attempts: queueing.max_attempts.unwrap_or(MAX_ATTEMPTS),
            needs: resolved.maker.into_iter().chain(queueing.needs).collect(),
        };
        let mut queued = self.queue(&Plan { jobs: vec![job], ..Plan::default() }).await?;
        queued.pop().ok_or_else(|| Error::internal("queueing a job", "it was not there afterwards"))
    }

    /// Queues a pipeline's jobs, whole or not at all, together with the move of the schedule that starts it.
    ///
    /// # Errors
    /// As for [`Jobs::submit`].
    pub(crate) async fn submit_pipeline(
        &self,
        task: &TaskId,
        pipeline: &PipelineSpec,
        priority: i32,
        start: Option<ScheduleStart>,
    ) -> Result<(Vec<Job>, Option<DatasetId>)> {
        let snapshot = self.snapshot(task, pipeline.snapshot_id.clone(), &pipeline.rule).await?;
        let plan = Plan { start, ..chain(task, pipeline, &snapshot, priority) };
        let dataset = plan.dataset.as_ref().map(|dataset| dataset.id.clone());
        Ok((self.queue(&plan).await?, dataset))
    }

    async fn queue(&self, plan: &Plan) -> Result<Vec<Job>> {
        let queued = self.0.store.insert_plan(plan).await?;
        for job in &queued {
            tracing::info!(job.id = %job.id, job.kind = job.spec.kind().as_str(), task.id = %job.task_id, "queued");
        }
        self.0.changed.send_replace(());
        self.0.ready.notify_one();
        Ok(queued)
    }

    async fn resolve(&self, task: &TaskId, order: JobOrder) -> Result<Resolved> {
        match order {
            JobOrder::Pretrain { snapshot_id, rule, spec } => {
                let snapshot_id = self.snapshot(task, snapshot_id, &rule).await?;
                let spec = JobSpec::Pretrain { snapshot_id, spec };
                Ok(Resolved { spec, result_id: EncoderId::new().into(), maker: None })
            }
            JobOrder::Score { encoder_id, snapshot_id, spec } => {
                let (maker, own) = self.encoder(task, "spec.score.encoder_id", &encoder_id).await?;
                let snapshot_id = match snapshot_id {
                    Some(id) => self.snapshot(task, Some(id), &RoleRule::default()).await?,
                    None => own,
                };
                let spec = JobSpec::Score { encoder_id, snapshot_id, spec };
                Ok(Resolved { spec, result_id: ScoreRunId::new().into(), maker: Some(maker) })
            }
            JobOrder::Train { data, spec } => {
                let (maker, encoder_id, snapshot_id, dataset_id) = match data {
                    TrainData::ExpertsOf(encoder) => {
                        let (maker, snapshot) = self.encoder(task, "spec.train.experts_of", &encoder).await?;
                        (maker, encoder, snapshot, None)
                    }
                    TrainData::Dataset(dataset) => {
                        let (maker, encoder, snapshot) = self.dataset(task, "spec.train.dataset_id", &dataset).await?;
                        (maker, encoder, snapshot, Some(dataset))
                    }
                };
                let spec = JobSpec::Train { encoder_id, snapshot_id, dataset_id, spec };
                Ok(Resolved { spec, result_id: PolicyId::new().into(), maker: Some(maker) })
            }
            JobOrder::Export { dataset_id } => {
                let (maker, _, _) = self.dataset(task, "spec.export.dataset_id", &dataset_id).await?;
                let spec = JobSpec::Export { dataset_id };
                Ok(Resolved { spec, result_id: ExportId::new().into(), maker: Some(maker) })
            }
        }
    }

    /// The named snapshot, or a new one under the rule.
    async fn snapshot(&self, task: &TaskId, named: Option<SnapshotId>, rule: &RoleRule) -> Result<SnapshotId> {
        let Some(id) = named else {
            return Ok(self.0.store.create_snapshot(task, rule).await?.id);
        };
        let (snapshot, _) = self.0.store.snapshot(&id).await?;
        same_task("snapshot_id", id.as_str(), &snapshot.task_id, task)?;
        Ok(id)
    }

    /// The job that makes an encoder, and the snapshot that it sees.
    async fn encoder(&self, task: &TaskId, field: &str, id: &EncoderId) -> Result<(JobId, SnapshotId)> {
        match self.0.store.job_of_result(id.as_str()).await? {
            Some(Job { id: maker, task_id, spec: JobSpec::Pretrain { snapshot_id, .. }, .. }) => {
                same_task(field, id.as_str(), &task_id, task)?;
                Ok((maker, snapshot_id))
            }
            Some(_) | None => Err(Error::not_found("encoder", id)),
        }
    }

    /// The job that makes a dataset's scores, and the encoder and snapshot that it works with.
    async fn dataset(&self, task: &TaskId, field: &str, id: &DatasetId) -> Result<(JobId, EncoderId, SnapshotId)> {
        let dataset = self.0.store.dataset(id).await?;
        same_task(field, id.as_str(), &dataset.task_id, task)?;
        match self.0.store.job_of_result(dataset.score_run_id.as_str()).await? {
            Some(Job { id: maker, spec: JobSpec::Score { encoder_id, snapshot_id, .. }, .. }) => {
                Ok((maker, encoder_id, snapshot_id))
            }
            Some(_) | None => Err(Error::not_found("score run", &dataset.score_run_id)),
        }
    }
}

fn same_task(field: &str, id: &str, found: &TaskId, task: &TaskId) -> Result<()> {
    if found == task {
        return Ok(());
    }
    Err(Error::invalid(field, format!("{id} belongs to {found}, not to {task}; name one of this task")))
}

/// Pretrain, then score, then a dataset, then train: each linked to the one before it.
fn chain(task: &TaskId, pipeline: &PipelineSpec, snapshot: &SnapshotId, priority: i32) -> Plan {
    let mut plan = Plan::default();
    let mut add = |spec: JobSpec, result_id: String| {
        let needs = plan.jobs.last().map(|before: &NewJob| before.id.clone()).into_iter().collect();
        let (id, task_id) = (JobId::new(), task.clone());
        plan.jobs.push(NewJob { id, task_id, spec, result_id, priority, max_attempts: MAX_ATTEMPTS, needs });
    };
    let (encoder, run) = (EncoderId::new(), ScoreRunId::new());
    let pretrain = pipeline.pretrain.clone();
    let device = pretrain.device;
    add(JobSpec::Pretrain { snapshot_id: snapshot.clone(), spec: pretrain }, encoder.clone().into());
    if !pipeline.score {
        return plan;
    }
    let spec = ScoreSpec { device, ..ScoreSpec::default() };
    add(JobSpec::Score { encoder_id: encoder.clone(), snapshot_id: snapshot.clone(), spec }, run.clone().into());
    let Some(beta) = pipeline.beta else { return plan };
    let dataset =
        Dataset { id: DatasetId::new(), task_id: task.clone(), score_run_id: run, beta, created_at: Millis::now() };
    if let Some(spec) = pipeline.train.clone() {
        let dataset_id = Some(dataset.id.clone());
        let spec = JobSpec::Train { encoder_id: encoder, snapshot_id: snapshot.clone(), dataset_id, spec };
        add(spec, PolicyId::new().into());
    }
    Plan { dataset: Some(dataset), ..plan }
}
