//! Rows of jobs: reading them and queueing new ones. Changes of state are in `queue`.

use futures::TryStreamExt as _;

use super::{
    Store, curation, dataset, fault, is_duplicate,
    row::{self, Column as _, record},
    schedule,
    sql::{self, QueryBuilder, Transaction},
};
use crate::{
    domain::{
        id::{EncoderId, JobId, TaskId},
        job::{Job, JobSpec, JobState},
        order::{JobFilter, KeyedOrder, NewJob, Plan},
        placement::Placement,
        time::Millis,
    },
    error::{Error, Result},
};

/// A job with the ids of its needs and, while it is queued, of those that have not ended, separated by commas; conditions
/// follow.
macro_rules! select_jobs {
    ($rest:literal) => {
        concat!(
            "select *, (select string_agg(needs, ',' order by needs) from job_dependencies where job_id = jobs.id) as needs, \
               (select string_agg(needs, ',' order by needs) from job_dependencies join jobs as needed \
                on needed.id = needs and needed.state in ('queued', 'running') \
                where job_id = jobs.id and jobs.state = 'queued') as waits_for \
             from jobs ",
            $rest
        )
    };
}

record! { Job:
    id, task_id, spec, state, priority, result_id, done, total, message, error, attempt, max_attempts, cancel_requested,
    checkpoint, checkpoint_step, peak_memory_bytes, needs, waits_for, created_at, started_at, ended_at, key, engine_options; placement
}

record! { Placement: engine, engine_id, node, waiting }

/// Reads a job inside a write.
pub(super) async fn by_id(tx: &mut Transaction, id: &JobId) -> Result<Option<Job>> {
    sql::query(select_jobs!("where id = $1"))
        .bind(id.param())
        .try_map(row::read)
        .fetch_optional(&mut *tx)
        .await
        .map_err(fault("reading a job"))
}

impl Store {
    /// A job.
    ///
    /// # Errors
    /// NotFound.
    pub(crate) async fn job(&self, id: &JobId) -> Result<Job> {
        sql::query(select_jobs!("where id = $1"))
            .bind(id.param())
            .try_map(row::read)
            .fetch_optional(self.read())
            .await
            .map_err(fault("reading a job"))?
            .ok_or_else(|| Error::not_found("job", id))
    }

    /// The job that makes or made this result, in any state.
    pub(crate) async fn job_of_result(&self, result_id: &str) -> Result<Option<Job>> {
        sql::query(select_jobs!("where result_id = $1"))
            .bind(result_id)
            .try_map(row::read)
            .fetch_optional(self.read())
            .await
            .map_err(fault("reading the job of a result"))
    }

    /// The encoder that the task's newest pretraining makes or has made, unless that failed or was cancelled: a trained one,
    /// or, if `trained` is false and the task has none, an untrained one.
    pub(crate) async fn newest_encoder(&self, task: &TaskId, trained: bool) -> Result<Option<EncoderId>> {
        let mut jobs = sql::query(select_jobs!(
            "where task_id = $1 and kind = 'pretrain' and state in ('queued', 'running', 'succeeded') order by id desc"
        ))
        .bind(task.param())
        .try_map(row::read::<Job>)
        .fetch(self.read());
        let mut untrained = None;
        while let Some(job) = jobs.try_next().await.map_err(fault("looking for a task's newest encoder"))? {
            let id = EncoderId::parse("result_id", &job.result_id)?;
            if matches!(job.spec, JobSpec::Pretrain { spec, .. } if !spec.is_untrained()) {
                return Ok(Some(id));
            }
            untrained = untrained.or(Some(id));
        }
        Ok(untrained.filter(|_| !trained))
    }

    /// Jobs of a task whose specs name one of these ids (of snapshots, results or datasets), oldest first. Ids occur in
    /// a spec only where they name an object, so the result has all such jobs, whether or not they had to wait.
    pub(crate) async fn jobs_naming(&self, task: &TaskId, ids: &[&str]) -> Result<Vec<Job>> {
        sql::query(select_jobs!(
            "where task_id = $1 and exists (select 1 from json_each($2) where instr(jobs.spec, value) > 0) order by id"
        ))
        .bind(task.param())
        .bind(serde_json::json!(ids).to_string())
        .try_map(row::read)
        .fetch_all(self.read())
        .await
        .map_err(fault("looking for the jobs that name a result"))
    }

    /// The task's job of this key that has not failed and was not cancelled, and its order.
    pub(crate) async fn job_of_key(&self, task: &TaskId, key: &str) -> Result<Option<(Job, KeyedOrder)>> {
        let held = "select id, ordered from jobs where task_id = $1 and key = $2 and key <> '' \
             and state not in ('failed', 'cancelled')";
        let found: Option<(JobId, KeyedOrder)> = sql::query(held)
            .bind(task.param())
            .bind(key)
            .try_map(row::read)
            .fetch_optional(self.read())
            .await
            .map_err(fault("looking for a key"))?;
        match found {
            Some((id, ordered)) => Ok(Some((self.job(&id).await?, ordered))),
            None => Ok(None),
        }
    }

    /// At most `size` jobs that match the filter and come before the id `before`, newest first. The second value is the
    /// `before` of the next page; `None` on the last one.
    pub(crate) async fn jobs(
        &self,
        filter: &JobFilter,
        before: Option<&JobId>,
        size: u32,
    ) -> Result<(Vec<Job>, Option<JobId>)> {
        let mut query = QueryBuilder::new(select_jobs!("where true"));
        if let Some(task) = &filter.task_id {
            query.push(" and task_id = ").push_bind(task.param());
        }
        if let Some(state) = filter.state {
            query.push(" and state = ").push_bind(state.param());
        }
        if let Some(kind) = filter.kind {
            query.push(" and kind = ").push_bind(kind.param());
        }
        if let Some(before) = before {
            query.push(" and id < ").push_bind(before.param());
        }
        // One row more than requested shows whether there is a next page.
        query.push(" order by id desc limit ").push_bind(i64::from(size) + 1);
        let mut jobs: Vec<Job> =
            query.build().try_map(row::read).fetch_all(self.read()).await.map_err(fault("listing jobs"))?;
        let size = usize::try_from(size).unwrap_or(usize::MAX);
        let more = jobs.len() > size;
        jobs.truncate(size);
        let next = if more { jobs.last().map(|job| job.id.clone()) } else { None };
        Ok((jobs, next))
    }

    /// Queues all jobs of a plan in one transaction.
    ///
    /// # Errors
    /// NotFound when a job to wait for is unknown; Precondition when one failed or was cancelled; Exists when another
    /// job took its key in the meantime, or equals a plan's job that may exist only once.
    pub(crate) async fn insert_plan(&self, plan: &Plan) -> Result<Vec<Job>> {
        let mut tx = self.write().await?;
        if let Some(first) = plan.jobs.first().filter(|_| plan.once) {
            curation::expect_none_alike(&mut tx, first).await?;
        }
        for job in &plan.jobs {
            insert(&mut tx, job).await?;
        }
        for dataset in &plan.datasets {
            dataset::insert(&mut tx, dataset).await?;
        }
        if let Some(start) = &plan.start {
            schedule::started(&mut tx, start).await?;
        }
        let mut queued = Vec::with_capacity(plan.jobs.len());
        for job in &plan.jobs {
            queued.extend(by_id(&mut tx, &job.id).await?);
        }
        crate::fail_point::pass("jobs.rows_written");
        self.commit(tx).await?;
        crate::fail_point::pass("jobs.committed");
        Ok(queued)
    }
}

async fn insert(tx: &mut Transaction, job: &NewJob) -> Result<()> {
    let ordered = job.keyed.as_ref().map(|keyed| serde_json::to_string(&keyed.order)).transpose();
    let ordered = ordered.map_err(|error| Error::internal("writing an order", error))?;
    sql::query(
        "insert into jobs (id, task_id, kind, spec, state, priority, result_id, max_attempts, created_at, key, ordered, \
         engine_options) values ($1, $2, $3, $4, 'queued', $5, $6, $7, $8, $9, $10, $11)",
    )
    .bind(job.id.param())
    .bind(job.task_id.param())
    .bind(job.spec.kind().param())
    .bind(job.spec.param())
    .bind(job.priority)
    .bind(&job.result_id)
    .bind(job.max_attempts)
    .bind(Millis::now().param())
    .bind(job.keyed.as_ref().map_or("", |keyed| keyed.key.as_str()))
    .bind(ordered.unwrap_or_default())
    .bind(&job.engine_options)
    .execute(&mut *tx)
    .await
    .map_err(|error| match &job.keyed {
        Some(keyed) if is_duplicate(&error) => Error::exists(format!("the key {:?} belongs to another job", keyed.key)),
        Some(_) | None => fault("queueing a job")(error),
    })?;
    for needed in &job.needs {
        let found = by_id(tx, needed).await?.ok_or_else(|| Error::not_found("job", needed))?;
        may_be_waited_for(&found)?;
        sql::query("insert into job_dependencies (job_id, needs) values ($1, $2) on conflict do nothing")
            .bind(job.id.param())
            .bind(needed.param())
            .execute(&mut *tx)
            .await
            .map_err(fault("adding a dependency"))?;
    }
    Ok(())
}

fn may_be_waited_for(job: &Job) -> Result<()> {
    match job.state {
        JobState::Queued | JobState::Running | JobState::Succeeded => Ok(()),
        JobState::Failed => Err(Error::precondition(format!(
            "{}, which makes {}, failed: {}; submit that again first",
            job.id, job.result_id, job.error
        ))),
        JobState::Cancelled => Err(Error::precondition(format!(
            "{}, which makes {}, was cancelled; submit that again first",
            job.id, job.result_id
        ))),
    }
}
