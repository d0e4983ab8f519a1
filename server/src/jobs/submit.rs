//! Submission: inputs are chosen, results get their ids, dependencies are found, and the jobs are queued in one
//! transaction.

use super::{
    Jobs,
    chain::{MAX_ATTEMPTS, chain},
    kinds::{self, Resolved},
};
use crate::{
    domain::{
        id::{DatasetId, JobId, ScoreRunId, TaskId},
        job::{Job, JobKind},
        order::{JobOrder, Keyed, KeyedOrder, NewJob, PipelineQueueing, Plan, Queueing},
        policy::no_history,
        schedule::{PipelineSpec, ScheduleStart},
    },
    error::{Error, Kind, Result},
};

impl Jobs {
    /// Queues a job, or returns the job that its key already names.
    ///
    /// # Errors
    /// NotFound for a missing object; Invalid for one that belongs to another task; Precondition when the snapshot
    /// would lack a role, when the job of an input failed, or when the server lacks the image weights; Exists when the
    /// key belongs to a job with another order; Precondition for options of an engine that has none; Exhausted when the disk is nearly full.
    pub(crate) async fn submit(&self, task: &TaskId, order: JobOrder, queueing: Queueing) -> Result<Job> {
        let ordered = KeyedOrder::Job(Box::new(order.clone()));
        if let Some(job) = self.known(task, &ordered, &queueing.key).await? {
            return Ok(job);
        }
        self.accept_options(&queueing.engine_options)?;
        self.0.blobs.room_for(0).await?;
        self.expect_weights(&order).await?;
        let mut resolved = kinds::resolve(self, task, order).await?;
        let key = queueing.key.clone();
        let mut jobs: Vec<NewJob> = Vec::new();
        if let Some(first) = resolved.first.take() {
            let job = new_job(task, *first, &queueing);
            resolved.maker = Some(job.id.clone());
            jobs.push(job);
        }
        let keyed = (!key.is_empty()).then(|| Keyed { key: key.clone(), order: ordered.clone() });
        jobs.push(NewJob { keyed, ..new_job(task, resolved, &queueing) });
        match self.queue(Plan { jobs, ..Plan::default() }).await {
            Ok(mut queued) => queued.pop().ok_or_else(|| Error::internal("queueing a job", "the new job has no row")),
            // Another caller queued the same work in the meantime.
            Err(error) if error.kind() == Kind::Exists => self.known(task, &ordered, &key).await?.ok_or(error),
            Err(error) => Err(error),
        }
    }

    /// The job that a key names; the last one of a pipeline.
    async fn known(&self, task: &TaskId, order: &KeyedOrder, key: &str) -> Result<Option<Job>> {
        if key.is_empty() {
            return Ok(None);
        }
        match self.0.store.job_of_key(task, key).await? {
            Some((job, ordered)) if ordered == *order => Ok(Some(job)),
            Some((job, _)) => Err(Error::exists(format!(
                "the key {key:?} belongs to {}, which was submitted with another spec; use another key, or that spec",
                job.id
            ))),
            None => Ok(None),
        }
    }

    /// Refuses options of an engine that has none.
    pub(super) fn accept_options(&self, engine_options: &str) -> Result<()> {
        if engine_options.is_empty() || self.0.engine.takes_options() {
            return Ok(());
        }
        Err(Error::precondition(format!(
            "engine_options: this server runs jobs by the engine {}, which has no options; leave them out (of a \
             schedule: delete it and create another), or start the server with --engine slurm",
            self.0.engine.name()
        )))
    }

    /// Queues a pipeline's jobs in one transaction, together with the new state of the schedule that starts it; or returns
    /// the jobs that its key already names. The last job has the key: it fails or is cancelled with each job before it, and
    /// so the key stands for the chain as long as that may succeed.
    ///
    /// # Errors
    /// As for [`Jobs::submit`].
    pub(crate) async fn submit_pipeline(
        &self,
        task: &TaskId,
        pipeline: &PipelineSpec,
        queueing: PipelineQueueing,
        start: Option<ScheduleStart>,
    ) -> Result<(Vec<Job>, Option<DatasetId>)> {
        let (key, ordered) = (queueing.key.clone(), KeyedOrder::Pipeline { pipeline: Box::new(pipeline.clone()) });
        if let Some(last) = self.known(task, &ordered, &key).await? {
            return self.chain_to(last, pipeline).await;
        }
        self.accept_options(&queueing.engine_options)?;
        self.0.blobs.room_for(0).await?;
        let complete = self.startable(task, pipeline).await?;
        let named = complete.snapshot_id.clone();
        let snapshot = self.snapshot(task, "pipeline.pretrain.snapshot_id", named, &complete.rule).await?;
        let mut plan = Plan { start, ..chain(task, complete, &snapshot, queueing) };
        if let Some(last) = plan.jobs.last_mut().filter(|_| !key.is_empty()) {
            last.keyed = Some(Keyed { key: key.clone(), order: ordered.clone() });
        }
        let dataset = plan.datasets.first().map(|dataset| dataset.id.clone());
        match self.queue(plan).await {
            Ok(jobs) => Ok((jobs, dataset)),
            // Another caller queued the same work in the meantime.
            Err(error) if error.kind() == Kind::Exists => {
                let last = self.known(task, &ordered, &key).await?.ok_or(error)?;
                self.chain_to(last, pipeline).await
            }
            Err(error) => Err(error),
        }
    }

    /// The pipeline with what the server fills in, or the reason why no start of it would queue a job.
    ///
    /// # Errors
    /// Invalid for trials of a task that cannot be simulated, or that hide the history of a policy without one; Precondition
    /// for image weights that the server lacks.
    pub(super) async fn startable(&self, task: &TaskId, pipeline: &PipelineSpec) -> Result<PipelineSpec> {
        expect_history(pipeline)?;
        let mut pipeline = pipeline.clone();
        if let Some(evaluate) = pipeline.evaluate.take() {
            pipeline.evaluate =
                Some(kinds::simulated(self, task, "pipeline.evaluate.settings.simulation", evaluate).await?);
        }
        self.expect_weights_of_pipeline(&pipeline).await?;
        Ok(pipeline)
    }

    /// The jobs of a queued pipeline from its last one, in order, and its dataset.
    async fn chain_to(&self, last: Job, pipeline: &PipelineSpec) -> Result<(Vec<Job>, Option<DatasetId>)> {
        let mut jobs = vec![last];
        while let Some(before) = jobs.last().and_then(|job| job.needs.first().cloned()) {
            jobs.push(self.0.store.job(&before).await?);
        }
        jobs.reverse();
        let score = jobs.iter().find(|job| job.spec.kind() == JobKind::Score);
        let (Some(score), Some(selection)) = (score, pipeline.selection()) else { return Ok((jobs, None)) };
        // Others may have seen the scores through the same selection since: the pipeline's own dataset is the oldest.
        let datasets = self.0.store.datasets_of_run(&ScoreRunId::parse("result_id", &score.result_id)?).await?;
        let own = datasets.into_iter().rev().find(|dataset| dataset.selection == selection);
        Ok((jobs, own.map(|dataset| dataset.id)))
    }

    pub(super) async fn queue(&self, plan: Plan) -> Result<Vec<Job>> {
        // Blobs of weights stay until the jobs that need them have rows.
        let naming = self.0.blobs.naming().await;
        let plan = self.with_stored_weights(plan).await?;
        let queued = self.0.store.insert_plan(&plan).await?;
        drop(naming);
        for job in &queued {
            tracing::info!(job.id = %job.id, job.kind = job.spec.kind().as_str(), task.id = %job.task_id, "queued");
        }
        self.0.changed.send_replace(());
        self.0.ready.notify_one();
        Ok(queued)
    }
}

/// A job without a key.
fn new_job(task: &TaskId, resolved: Resolved, queueing: &Queueing) -> NewJob {
    let Resolved { spec, result_id, maker, first: _ } = resolved;
    NewJob {
        id: JobId::new(),
        task_id: task.clone(),
        spec,
        result_id,
        priority: queueing.priority,
        max_attempts: queueing.max_attempts.unwrap_or(MAX_ATTEMPTS),
        engine_options: queueing.engine_options.clone(),
        needs: maker.into_iter().chain(queueing.needs.iter().cloned()).collect(),
        keyed: None,
    }
}

/// Rejects trials that hide the history of a policy that has none.
fn expect_history(pipeline: &PipelineSpec) -> Result<()> {
    let (Some(train), Some(evaluate)) = (&pipeline.train, &pipeline.evaluate) else { return Ok(()) };
    let steps = train.history_steps().unwrap_or(pipeline.pretrain.model.segment_length.into());
    if evaluate.hide_history && steps == 0 {
        let policy = format!("the policy {}", train.policy.name);
        return Err(no_history("pipeline.evaluate.settings.hide_history", &policy));
    }
    Ok(())
}

#[cfg(test)]
mod tests;
