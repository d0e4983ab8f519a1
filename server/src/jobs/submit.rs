//! Submission: inputs are chosen, results get their ids, dependencies are found, and the jobs are queued in one
//! transaction.

use super::{
    Jobs,
    chain::{MAX_ATTEMPTS, chain},
    kinds,
};
use crate::{
    domain::{
        id::{DatasetId, JobId, TaskId},
        job::Job,
        order::{JobOrder, Keyed, NewJob, PipelineQueueing, Plan, Queueing},
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
        if let Some(job) = self.known(task, &order, &queueing.key).await? {
            return Ok(job);
        }
        self.accept_options(&queueing.engine_options)?;
        self.0.blobs.room_for(0).await?;
        self.expect_weights(&order).await?;
        let resolved = kinds::resolve(self, task, order.clone()).await?;
        let Queueing { priority, needs, max_attempts, key, engine_options } = queueing;
        let keyed = (!key.is_empty()).then(|| Keyed { key: key.clone(), order: order.clone() });
        let job = NewJob {
            id: JobId::new(),
            task_id: task.clone(),
            spec: resolved.spec,
            result_id: resolved.result_id,
            priority,
            max_attempts: max_attempts.unwrap_or(MAX_ATTEMPTS),
            engine_options,
            needs: resolved.maker.into_iter().chain(needs).collect(),
            keyed,
        };
        match self.queue(Plan { jobs: vec![job], ..Plan::default() }).await {
            Ok(mut queued) => queued.pop().ok_or_else(|| Error::internal("queueing a job", "the new job has no row")),
            // Another caller queued the same work in the meantime.
            Err(error) if error.kind() == Kind::Exists => self.known(task, &order, &key).await?.ok_or(error),
            Err(error) => Err(error),
        }
    }

    /// The job that a key names.
    async fn known(&self, task: &TaskId, order: &JobOrder, key: &str) -> Result<Option<Job>> {
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

    /// Queues a pipeline's jobs in one transaction, together with the new state of the schedule that starts it.
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
        self.accept_options(&queueing.engine_options)?;
        self.0.blobs.room_for(0).await?;
        let mut pipeline = pipeline.clone();
        if let Some(evaluate) = pipeline.evaluate.take() {
            pipeline.evaluate =
                Some(kinds::simulated(self, task, "pipeline.evaluate.settings.simulation", evaluate).await?);
        }
        self.expect_weights_of_pipeline(&pipeline).await?;
        let named = pipeline.snapshot_id.clone();
        let snapshot = self.snapshot(task, "pipeline.pretrain.snapshot_id", named, &pipeline.rule).await?;
        let plan = Plan { start, ..chain(task, pipeline, &snapshot, queueing) };
        let dataset = plan.datasets.first().map(|dataset| dataset.id.clone());
        Ok((self.queue(plan).await?, dataset))
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
