//! Queries for retrying a job: its order, the jobs that ended with it, and an equal job in progress.

use crate::{
    domain::{
        id::JobId,
        job::{Job, JobState},
        order::{KeyedOrder, NewJob},
    },
    error::{Error, Result},
    store::{
        Store, fault,
        row::{self, Column as _},
        sql::{self, Transaction},
    },
};

impl Store {
    /// The order of a job that has a key, as its caller sent it.
    ///
    /// # Errors
    /// Internal, also for a job without a key.
    pub(crate) async fn ordered(&self, job: &JobId) -> Result<KeyedOrder> {
        sql::query("select ordered from jobs where id = $1")
            .bind(job.param())
            .try_map(row::read)
            .fetch_one(self.read())
            .await
            .map_err(fault("reading an order"))
    }

    /// The jobs that never started because they waited, directly or not, for this one, which failed or was cancelled;
    /// each after those it waits for.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn ended_with(&self, job: &JobId, state: JobState) -> Result<Vec<Job>> {
        let ids: Vec<JobId> = sql::query(
            "with recursive waiting(id) as (select job_id from job_dependencies where needs = $1 \
               union select job_id from job_dependencies join waiting on needs = waiting.id) \
             select id from jobs where id in (select id from waiting) and state = $2 and started_at is null order by id",
        )
        .bind(job.param())
        .bind(state.param())
        .try_map(row::read)
        .fetch_all(self.read())
        .await
        .map_err(fault("looking for the jobs that waited"))?;
        let mut jobs = Vec::with_capacity(ids.len());
        for id in ids {
            jobs.push(self.job(&id).await?);
        }
        Ok(jobs)
    }
}

/// Rejects a job when an equal one of its task has not ended.
///
/// # Errors
/// Exists, with the id of that job.
pub(in crate::store) async fn expect_none_alike(tx: &mut Transaction, job: &NewJob) -> Result<()> {
    let alike: Option<JobId> =
        sql::query("select id from jobs where task_id = $1 and state in ('queued', 'running') and spec = $2 limit 1")
            .bind(job.task_id.param())
            .bind(job.spec.param())
            .try_map(row::read)
            .fetch_optional(&mut *tx)
            .await
            .map_err(fault("looking for a job that does the same"))?;
    match alike {
        Some(id) => {
            Err(Error::exists(format!("{id} has the same order and has not ended; watch it, or cancel it first")))
        }
        None => Ok(()),
    }
}
