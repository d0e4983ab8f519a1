//! The attempt of a job: whether it is still running.

use sqlx::{Sqlite, Transaction};

use super::{fault, job::by_id, row::Column as _};
use crate::{
    domain::{attempt::Attempt, job::Job},
    error::{Error, Result},
};

/// The error of a worker whose attempt has ended.
pub(super) fn attempt_is_over() -> Error {
    Error::precondition("this attempt of the job is over")
}

/// The job of an attempt inside a write, if that attempt is running.
pub(super) async fn running(tx: &mut Transaction<'_, Sqlite>, attempt: &Attempt) -> Result<Option<Job>> {
    let held: Option<i64> =
        sqlx::query_scalar("select 1 from jobs where id = ? and coalesce(token_hash, '') = ? and state = 'running'")
            .bind(attempt.job_id.param())
            .bind(&attempt.token_hash)
            .fetch_optional(&mut **tx)
            .await
            .map_err(fault("looking for an attempt"))?;
    if held.is_some() { by_id(tx, &attempt.job_id).await } else { Ok(None) }
}
