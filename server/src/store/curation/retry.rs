//! What a retry needs to know: how a job was ordered, and which jobs ended because it did.

use crate::{
    domain::{
        id::JobId,
        job::{Job, JobState},
        order::JobOrder,
    },
    error::Result,
    store::{Store, fault, row},
};

impl Store {
    /// What a job was asked to do, as its caller said it where it has a key, else as it was understood.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn ordered(&self, job: &Job) -> Result<JobOrder> {
        let ordered: String = sqlx::query_scalar("select ordered from jobs where id = ?")
            .bind(job.id.as_str())
            .fetch_one(self.read())
            .await
            .map_err(fault("reading an order"))?;
        if ordered.is_empty() { Ok(job.spec.clone().into()) } else { row::json("jobs.ordered", &ordered) }
    }

    /// The jobs that never began because they waited, directly or not, for this one, which failed or was cancelled;
    /// each after those it waits for.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn ended_with(&self, job: &JobId, state: JobState) -> Result<Vec<Job>> {
        let ids: Vec<String> = sqlx::query_scalar(
            "with recursive waiting(id) as (select job_id from job_dependencies where needs = ?1 \
               union select job_id from job_dependencies join waiting on needs = waiting.id) \
             select id from jobs where id in (select id from waiting) and state = ?2 and started_at is null order by id",
        )
        .bind(job.as_str())
        .bind(state.as_str())
        .fetch_all(self.read())
        .await
        .map_err(fault("looking for the jobs that waited"))?;
        let mut jobs = Vec::with_capacity(ids.len());
        for id in ids {
            jobs.push(self.job(&row::id("jobs.id", id)?).await?);
        }
        Ok(jobs)
    }
}
