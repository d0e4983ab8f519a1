//! Changes of jobs' states: claimed, ended, cancelled. Each one checks `JobState::may_become`.

use super::{
    Store, attempt, fault,
    job::by_id,
    metric,
    row::{self, Column as _},
    sql::{self, Transaction},
};
use crate::{
    domain::{
        attempt::{Attempt, AttemptEnd, Standing},
        id::{BlobId, JobId},
        job::{Job, JobState},
        time::Millis,
    },
    error::{Error, Result},
};

/// A job whose state changed, and the blob that its row no longer names.
#[derive(Debug)]
pub(crate) struct Moved {
    /// The job after the change.
    pub(crate) job: Job,
    /// Its previous checkpoint, if it is no longer needed.
    pub(crate) dropped: Option<BlobId>,
}

impl Store {
    /// Assigns a job to the attempt with this token, which runs by this engine: of the queued jobs whose needs have all succeeded, the one of
    /// highest priority, then the oldest.
    pub(crate) async fn claim_job(&self, token_hash: &str, engine: &str) -> Result<Option<Job>> {
        let mut tx = self.write().await?;
        let claimed: Option<JobId> = sql::query(
            "update jobs set state = 'running', attempt = attempt + 1, token_hash = $1, started_at = $2, engine = $3, \
             engine_id = '', node = '', waiting = '', process = null where id = (select id from jobs as ready where state = 'queued' and not exists ( \
               select 1 from job_dependencies join jobs as needed on needed.id = job_dependencies.needs \
               where job_dependencies.job_id = ready.id and needed.state <> 'succeeded') \
             order by priority desc, id limit 1) returning id",
        )
        .bind(token_hash)
        .bind(Millis::now().param())
        .bind(engine)
        .try_map(row::read)
        .fetch_optional(&mut tx)
        .await
        .map_err(fault("claiming a job"))?;
        let Some(id) = claimed else { return Ok(None) };
        let job = by_id(&mut tx, &id).await?;
        crate::fail_point::pass("claim.row_written");
        self.commit(tx).await?;
        crate::fail_point::pass("claim.committed");
        Ok(job)
    }

    /// Queues the job again that the claim with this token got, if it got one; the attempt does not count.
    pub(crate) async fn give_back(&self, token_hash: &str) -> Result<()> {
        // By the writer: a connection that was lost during the commit has ended then, with or without the claim.
        let mut tx = self.write().await?;
        let claimed: Option<JobId> = row::query_as("select id from jobs where token_hash = $1 and state = 'running'")
            .bind(token_hash)
            .fetch_optional(&mut tx)
            .await
            .map_err(fault("looking for a claim"))?;
        drop(tx);
        if let Some(job_id) = claimed {
            let attempt = Attempt { job_id, token_hash: token_hash.to_owned() };
            self.end_attempt(&attempt, &AttemptEnd::Stopped).await?;
        }
        Ok(())
    }

    /// Ends an attempt without a result. `None` when it had already ended.
    pub(crate) async fn end_attempt(&self, attempt: &Attempt, end: &AttemptEnd) -> Result<Option<Moved>> {
        let mut tx = self.write().await?;
        let Some(job) = attempt::running(&mut tx, attempt).await? else { return Ok(None) };
        let next = end.next(Standing {
            attempt: job.attempt,
            max_attempts: job.max_attempts,
            checkpoint_step: job.checkpoint_step,
            cancel_requested: job.cancel_requested,
        });
        // The progress that the next attempt begins with: that of this one would make its rate look far too high.
        let done = if next.state == JobState::Queued { job.checkpoint_step.unwrap_or(0) } else { job.done };
        sql::query("update jobs set attempt = $1, done = $2 where id = $3")
            .bind(next.attempt)
            .bind(done.param())
            .bind(job.id.param())
            .execute(&mut tx)
            .await
            .map_err(fault("counting attempts"))?;
        let moved = advance(&mut tx, &job, next.state, &next.message, &next.error).await?;
        if next.state == JobState::Queued {
            metric::cut_back(&mut tx, &job.id, job.checkpoint_step).await?;
        }
        crate::fail_point::pass("attempt.row_written");
        self.commit(tx).await?;
        crate::fail_point::pass("attempt.committed");
        Ok(Some(moved))
    }

    /// Cancels a job, and the jobs that wait for it: at once if it is queued, else by asking its worker.
    ///
    /// # Errors
    /// NotFound; Precondition when it has ended.
    pub(crate) async fn cancel_job(&self, id: &JobId) -> Result<Moved> {
        let mut tx = self.write().await?;
        let job = by_id(&mut tx, id).await?.ok_or_else(|| Error::not_found("job", id))?;
        let moved = if job.state == JobState::Running {
            sql::query("update jobs set cancel_requested = true, message = 'cancelling' where id = $1")
                .bind(id.param())
                .execute(&mut tx)
                .await
                .map_err(fault("asking a job to stop"))?;
            drop_dependents(&mut tx, id, JobState::Cancelled).await?;
            Moved { job: reread(&mut tx, id).await?, dropped: None }
        } else {
            advance(&mut tx, &job, JobState::Cancelled, "cancelled", "").await?
        };
        crate::fail_point::pass("cancel.row_written");
        self.commit(tx).await?;
        crate::fail_point::pass("cancel.committed");
        Ok(moved)
    }

    /// Names the blob to resume from; returns the blob that was named before.
    ///
    /// # Errors
    /// Precondition when the attempt has ended.
    pub(crate) async fn save_checkpoint(&self, attempt: &Attempt, step: u64, blob: &BlobId) -> Result<Option<BlobId>> {
        let mut tx = self.write().await?;
        let job = attempt::running(&mut tx, attempt).await?.ok_or_else(attempt::attempt_is_over)?;
        sql::query("update jobs set checkpoint = $1, checkpoint_step = $2 where id = $3")
            .bind(blob.param())
            .bind(step.param())
            .bind(job.id.param())
            .execute(&mut tx)
            .await
            .map_err(fault("saving a checkpoint"))?;
        crate::fail_point::pass("checkpoint.row_written");
        self.commit(tx).await?;
        crate::fail_point::pass("checkpoint.committed");
        Ok(job.checkpoint.filter(|old| old != blob))
    }
}

impl Store {
    /// Restarts a running job without this checkpoint and its reports; one that was saved since stays.
    pub(crate) async fn drop_checkpoint(&self, id: &JobId, checkpoint: &BlobId) -> Result<()> {
        let mut tx = self.write().await?;
        let dropped = sql::query(
            "update jobs set checkpoint = null, checkpoint_step = null, done = 0 where id = $1 and checkpoint = $2",
        )
        .bind(id.param())
        .bind(checkpoint.param())
        .execute(&mut tx)
        .await
        .map_err(fault("dropping a checkpoint"))?;
        if dropped > 0 {
            metric::cut_back(&mut tx, id, None).await?;
        }
        self.commit(tx).await
    }
}

/// Changes a job's state to `next`. Its worker's reports are rejected afterwards; if it has ended, its checkpoint is
/// dropped, and the jobs that wait for a failed result end too.
pub(super) async fn advance(
    tx: &mut Transaction,
    job: &Job,
    next: JobState,
    message: &str,
    error: &str,
) -> Result<Moved> {
    if !job.state.may_become(next) {
        return Err(Error::precondition(format!("{} has already ended: it is {}", job.id, job.state.as_str())));
    }
    let ended = next.ended();
    sql::query(
        "update jobs set state = $1, message = $2, error = $3, token_hash = null, ended_at = $4, waiting = '', \
         checkpoint = case when $5 then null else checkpoint end, \
         checkpoint_step = case when $5 then null else checkpoint_step end where id = $6",
    )
    .bind(next.param())
    .bind(message)
    .bind(error)
    .bind(ended.then(Millis::now).param())
    .bind(ended)
    .bind(job.id.param())
    .execute(&mut *tx)
    .await
    .map_err(fault("moving a job"))?;
    if matches!(next, JobState::Failed | JobState::Cancelled) {
        drop_dependents(tx, &job.id, next).await?;
    }
    Ok(Moved { job: reread(tx, &job.id).await?, dropped: job.checkpoint.clone().filter(|_| ended) })
}

/// Ends every queued job that waits, directly or not, for a job without a result.
async fn drop_dependents(tx: &mut Transaction, id: &JobId, state: JobState) -> Result<()> {
    let (message, error) = match state {
        JobState::Failed => ("failed", format!("{id}, which this job waits for, failed")),
        JobState::Cancelled | JobState::Queued | JobState::Running | JobState::Succeeded => {
            ("cancelled with the job it waits for", String::new())
        }
    };
    sql::query(
        "with recursive waiting(id) as (select job_id from job_dependencies where needs = $1 \
           union select job_id from job_dependencies join waiting on needs = waiting.id) \
         update jobs set state = $2, message = $3, error = $4, ended_at = $5 \
         where state = 'queued' and id in (select id from waiting)",
    )
    .bind(id.param())
    .bind(state.param())
    .bind(message)
    .bind(error)
    .bind(Millis::now().param())
    .execute(&mut *tx)
    .await
    .map_err(fault("ending the jobs that wait"))?;
    Ok(())
}

async fn reread(tx: &mut Transaction, id: &JobId) -> Result<Job> {
    by_id(tx, id).await?.ok_or_else(|| Error::internal("reading a job back", "it is gone"))
}

#[cfg(test)]
mod tests;
