//! The attempt of a job: whether it is running, which process may speak for it, and where it runs.

use super::{
    Store, fault,
    job::by_id,
    row::{self, Column as _, Record as _},
    sql::{self, Transaction},
};
use crate::{
    domain::{attempt::Attempt, job::Job, placement::Placement},
    error::{Error, Result},
};

/// A running attempt according to its row.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct RunningAttempt {
    pub(crate) attempt: Attempt,
    pub(crate) placement: Placement,
    /// Whether a worker has called.
    pub(crate) bound: bool,
}

/// The answer to a process that presents the token of an attempt.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Claimant {
    /// The attempt is this process's.
    Worker(Box<Job>),
    /// The attempt is running, in another process.
    Other,
    /// The attempt has ended, or is unknown.
    Over,
}

/// The error of a worker whose attempt has ended.
pub(super) fn attempt_is_over() -> Error {
    Error::precondition("this attempt of the job is over")
}

/// The job of an attempt inside a write, if that attempt is running.
pub(super) async fn running(tx: &mut Transaction, attempt: &Attempt) -> Result<Option<Job>> {
    let held: Option<i64> =
        row::query_as("select 1 from jobs where id = $1 and coalesce(token_hash, '') = $2 and state = 'running'")
            .bind(attempt.job_id.param())
            .bind(&attempt.token_hash)
            .fetch_optional(&mut *tx)
            .await
            .map_err(fault("looking for an attempt"))?;
    if held.is_some() { by_id(tx, &attempt.job_id).await } else { Ok(None) }
}

impl Store {
    /// Whether `process` may speak for an attempt. The first process that asks is bound to the attempt, also across
    /// restarts of the server, and its node is recorded unless its name is empty.
    pub(crate) async fn claimant(&self, attempt: &Attempt, process: &str, node: &str) -> Result<Claimant> {
        let bound = match self.bound_process(attempt).await? {
            None => return Ok(Claimant::Over),
            Some(None) => {
                self.bind_process(attempt, process, node).await?;
                // Another process may have been faster.
                self.bound_process(attempt).await?.flatten()
            }
            Some(bound) => bound,
        };
        match bound {
            Some(bound) if bound == process => Ok(Claimant::Worker(Box::new(self.job(&attempt.job_id).await?))),
            Some(_) => Ok(Claimant::Other),
            None => Ok(Claimant::Over),
        }
    }

    /// The job of an attempt, if that is running.
    pub(crate) async fn running_job(&self, attempt: &Attempt) -> Result<Option<Job>> {
        match self.bound_process(attempt).await? {
            Some(_) => Ok(Some(self.job(&attempt.job_id).await?)),
            None => Ok(None),
        }
    }

    /// The process of a running attempt, once one has called; `None` for an attempt that is not running.
    async fn bound_process(&self, attempt: &Attempt) -> Result<Option<Option<String>>> {
        row::query_as("select process from jobs where id = $1 and token_hash = $2 and state = 'running'")
            .bind(attempt.job_id.param())
            .bind(&attempt.token_hash)
            .fetch_optional(self.read())
            .await
            .map_err(fault("looking for an attempt"))
    }

    async fn bind_process(&self, attempt: &Attempt, process: &str, node: &str) -> Result<()> {
        let mut tx = self.write().await?;
        sql::query(
            "update jobs set process = $1, waiting = '', node = coalesce(nullif($2, ''), node) \
             where id = $3 and token_hash = $4 and state = 'running' and process is null",
        )
        .bind(process)
        .bind(node)
        .bind(attempt.job_id.param())
        .bind(&attempt.token_hash)
        .execute(&mut tx)
        .await
        .map_err(fault("binding an attempt to its process"))?;
        crate::fail_point::pass("process.row_written");
        self.commit(tx).await?;
        crate::fail_point::pass("process.committed");
        Ok(())
    }

    /// Stores where a running attempt runs; an unknown node keeps the recorded one.
    pub(crate) async fn place_attempt(&self, attempt: &Attempt, placement: &Placement) -> Result<()> {
        let mut tx = self.write().await?;
        sql::query(
            "update jobs set engine = $1, engine_id = $2, node = coalesce(nullif($3, ''), node), waiting = $4 \
             where id = $5 and token_hash = $6 and state = 'running'",
        )
        .bind(&placement.engine)
        .bind(&placement.engine_id)
        .bind(&placement.node)
        .bind(&placement.waiting)
        .bind(attempt.job_id.param())
        .bind(&attempt.token_hash)
        .execute(&mut tx)
        .await
        .map_err(fault("storing the place of an attempt"))?;
        self.commit(tx).await
    }

    /// Every running attempt according to the rows: at the start, those of an earlier server.
    pub(crate) async fn running_attempts(&self) -> Result<Vec<RunningAttempt>> {
        sql::query(
            "select id, coalesce(token_hash, '') as token_hash, engine, engine_id, node, waiting, \
             process is not null as bound from jobs where state = 'running'",
        )
        .try_map(|row| {
            let attempt = Attempt { job_id: row::column(&row, "id")?, token_hash: row::column(&row, "token_hash")? };
            Ok(RunningAttempt { attempt, placement: Placement::decode(&row)?, bound: row::column(&row, "bound")? })
        })
        .fetch_all(self.read())
        .await
        .map_err(fault("listing running attempts"))
    }
}

#[cfg(test)]
mod tests;
