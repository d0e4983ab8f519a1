//! Policies.

use super::{
    Store, fault,
    row::{self, Column as _, record},
    sql::{self, Transaction},
};
use crate::{
    domain::{
        id::{PolicyId, TaskId},
        job::JobKind,
        policy::Policy,
    },
    error::Result,
};

record! { Policy: id, task_id, job_id, kind, encoder_id, dataset_id, checkpoint, created_at }

/// Adds a finished policy.
pub(super) async fn insert(tx: &mut Transaction, policy: &Policy) -> Result<()> {
    sql::query(
        "insert into policies (id, task_id, job_id, kind, encoder_id, dataset_id, checkpoint, created_at) \
         values ($1, $2, $3, $4, $5, $6, $7, $8)",
    )
    .bind(policy.id.param())
    .bind(policy.task_id.param())
    .bind(policy.job_id.param())
    .bind(&policy.kind)
    .bind(policy.encoder_id.param())
    .bind(policy.dataset_id.param())
    .bind(policy.checkpoint.param())
    .bind(policy.created_at.param())
    .execute(&mut *tx)
    .await
    .map_err(fault("adding a policy"))?;
    Ok(())
}

impl Store {
    /// A finished policy.
    ///
    /// # Errors
    /// NotFound, or Precondition naming its job when that has not succeeded.
    pub(crate) async fn policy(&self, id: &PolicyId) -> Result<Policy> {
        let found = sql::query("select * from policies where id = $1")
            .bind(id.param())
            .try_map(row::read)
            .fetch_optional(self.read())
            .await
            .map_err(fault("reading a policy"))?;
        match found {
            Some(found) => Ok(found),
            None => Err(self.missing(JobKind::Train, "policy", id.as_str()).await),
        }
    }

    /// A task's policies, newest first.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn policies(&self, task: &TaskId) -> Result<Vec<Policy>> {
        sql::query("select * from policies where task_id = $1 order by id desc")
            .bind(task.param())
            .try_map(row::read)
            .fetch_all(self.read())
            .await
            .map_err(fault("reading policies"))
    }
}
