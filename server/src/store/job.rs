//! Rows of jobs: reading them and queueing new ones. Changes of state are in `queue`.

use sqlx::{QueryBuilder, Sqlite, Transaction};

use super::{Store, curation, dataset, fault, is_duplicate, row, schedule};
use crate::{
    domain::{
        id::{BlobId, JobId, TaskId},
        job::{Job, JobState},
        order::{JobFilter, JobOrder, NewJob, Plan},
        time::Millis,
    },
    error::{Error, Result},
};

/// A job with the ids of its needs, separated by commas; conditions follow.
macro_rules! select_jobs {
    ($rest:literal) => {
        concat!(
            "select *, (select group_concat(needs) from job_dependencies where job_id = jobs.id) as needs from jobs ",
            $rest
        )
    };
}

#[derive(sqlx::FromRow)]
struct JobRow {
    id: String,
    task_id: String,
    spec: String,
    state: String,
    priority: i32,
    result_id: String,
    done: i64,
    total: i64,
    message: String,
    error: String,
    attempt: u32,
    max_attempts: u32,
    cancel_requested: bool,
    checkpoint: Option<String>,
    checkpoint_step: Option<i64>,
    peak_memory_bytes: i64,
    created_at: i64,
    started_at: Option<i64>,
    ended_at: Option<i64>,
    key: String,
    needs: Option<String>,
}

impl JobRow {
    fn read(self) -> Result<Job> {
        let needs = self.needs.unwrap_or_default();
        let needs = needs.split(',').filter(|id| !id.is_empty());
        Ok(Job {
            id: row::id("jobs.id", self.id)?,
            task_id: row::id("jobs.task_id", self.task_id)?,
            spec: row::json("jobs.spec", &self.spec)?,
            state: row::parsed("jobs.state", JobState::from_word(&self.state))?,
            priority: self.priority,
            result_id: self.result_id,
            done: row::count("jobs.done", self.done)?,
            total: row::count("jobs.total", self.total)?,
            message: self.message,
            error: self.error,
            attempt: self.attempt,
            max_attempts: self.max_attempts,
            cancel_requested: self.cancel_requested,
            checkpoint: self.checkpoint.map(|blob| row::id::<BlobId>("jobs.checkpoint", blob)).transpose()?,
            checkpoint_step: self.checkpoint_step.map(|step| row::count("jobs.checkpoint_step", step)).transpose()?,
            peak_memory_bytes: row::count("jobs.peak_memory_bytes", self.peak_memory_bytes)?,
            needs: needs.map(|id| row::id("job_dependencies.needs", id.to_owned())).collect::<Result<_>>()?,
            created_at: Millis(self.created_at),
            started_at: self.started_at.map(Millis),
            ended_at: self.ended_at.map(Millis),
            key: self.key,
        })
    }
}

/// Reads a job inside a write.
pub(super) async fn by_id(tx: &mut Transaction<'_, Sqlite>, id: &JobId) -> Result<Option<Job>> {
    let found: Option<JobRow> = sqlx::query_as(select_jobs!("where id = ?"))
        .bind(id.as_str())
        .fetch_optional(&mut **tx)
        .await
        .map_err(fault("reading a job"))?;
    found.map(JobRow::read).transpose()
}

impl Store {
    /// A job.
    ///
    /// # Errors
    /// NotFound.
    pub(crate) async fn job(&self, id: &JobId) -> Result<Job> {
        let found: Option<JobRow> = sqlx::query_as(select_jobs!("where id = ?"))
            .bind(id.as_str())
            .fetch_optional(self.read())
            .await
            .map_err(fault("reading a job"))?;
        found.ok_or_else(|| Error::not_found("job", id))?.read()
    }

    /// The job that makes or made this result, in any state.
    pub(crate) async fn job_of_result(&self, result_id: &str) -> Result<Option<Job>> {
        let found: Option<JobRow> = sqlx::query_as(select_jobs!("where result_id = ?"))
            .bind(result_id)
            .fetch_optional(self.read())
            .await
            .map_err(fault("reading the job of a result"))?;
        found.map(JobRow::read).transpose()
    }

    /// Jobs of a task whose specs name one of these ids (of snapshots, results or datasets), oldest first. Ids occur in
    /// a spec only where they name an object, so the result has all such jobs, whether or not they had to wait.
    pub(crate) async fn jobs_naming(&self, task: &TaskId, ids: &[&str]) -> Result<Vec<Job>> {
        let rows: Vec<JobRow> = sqlx::query_as(select_jobs!(
            "where task_id = ? and exists (select 1 from json_each(?) where instr(jobs.spec, value) > 0) order by id"
        ))
        .bind(task.as_str())
        .bind(row::to_json(&ids)?)
        .fetch_all(self.read())
        .await
        .map_err(fault("looking for the jobs that name a result"))?;
        rows.into_iter().map(JobRow::read).collect()
    }

    /// The task's job of this key that has not failed and was not cancelled, and its order.
    pub(crate) async fn job_of_key(&self, task: &TaskId, key: &str) -> Result<Option<(Job, JobOrder)>> {
        let held = "select id, ordered from jobs where task_id = ? and key = ? and key <> '' \
             and state not in ('failed', 'cancelled')";
        let found: Option<(String, String)> = sqlx::query_as(held)
            .bind(task.as_str())
            .bind(key)
            .fetch_optional(self.read())
            .await
            .map_err(fault("looking for a key"))?;
        match found {
            Some((id, ordered)) => {
                let job = self.job(&row::id("jobs.id", id)?).await?;
                Ok(Some((job, row::json("jobs.ordered", &ordered)?)))
            }
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
        let mut query = QueryBuilder::<Sqlite>::new(select_jobs!("where true"));
        if let Some(task) = &filter.task_id {
            query.push(" and task_id = ").push_bind(task.as_str());
        }
        if let Some(state) = filter.state {
            query.push(" and state = ").push_bind(state.as_str());
        }
        if let Some(kind) = filter.kind {
            query.push(" and kind = ").push_bind(kind.as_str());
        }
        if let Some(before) = before {
            query.push(" and id < ").push_bind(before.as_str());
        }
        // One row more than requested shows whether there is a next page.
        query.push(" order by id desc limit ").push_bind(i64::from(size) + 1);
        let rows: Vec<JobRow> = query.build_query_as().fetch_all(self.read()).await.map_err(fault("listing jobs"))?;
        let size = usize::try_from(size).unwrap_or(usize::MAX);
        let more = rows.len() > size;
        let jobs = rows.into_iter().take(size).map(JobRow::read).collect::<Result<Vec<_>>>()?;
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

async fn insert(tx: &mut Transaction<'_, Sqlite>, job: &NewJob) -> Result<()> {
    sqlx::query(
        "insert into jobs (id, task_id, kind, spec, state, priority, result_id, max_attempts, created_at, key, ordered) \
         values (?, ?, ?, ?, 'queued', ?, ?, ?, ?, ?, ?)",
    )
    .bind(job.id.as_str())
    .bind(job.task_id.as_str())
    .bind(job.spec.kind().as_str())
    .bind(row::to_json(&job.spec)?)
    .bind(job.priority)
    .bind(&job.result_id)
    .bind(job.max_attempts)
    .bind(Millis::now().0)
    .bind(job.keyed.as_ref().map_or("", |keyed| keyed.key.as_str()))
    .bind(job.keyed.as_ref().map(|keyed| row::to_json(&keyed.order)).transpose()?.unwrap_or_default())
    .execute(&mut **tx)
    .await
    .map_err(|error| match &job.keyed {
        Some(keyed) if is_duplicate(&error) => Error::exists(format!("the key {:?} belongs to another job", keyed.key)),
        Some(_) | None => fault("queueing a job")(error),
    })?;
    for needed in &job.needs {
        let found = by_id(tx, needed).await?.ok_or_else(|| Error::not_found("job", needed))?;
        may_be_waited_for(&found)?;
        sqlx::query("insert or ignore into job_dependencies (job_id, needs) values (?, ?)")
            .bind(job.id.as_str())
            .bind(needed.as_str())
            .execute(&mut **tx)
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
