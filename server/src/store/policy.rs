//! Policies.

use sqlx::{Sqlite, Transaction};

use super::{Store, fault, row};
use crate::{
    domain::{
        id::{PolicyId, TaskId},
        job::JobKind,
        policy::Policy,
        time::Millis,
    },
    error::Result,
};

#[derive(sqlx::FromRow)]
struct PolicyRow {
    id: String,
    task_id: String,
    job_id: String,
    kind: String,
    encoder_id: Option<String>,
    dataset_id: Option<String>,
    checkpoint: String,
    created_at: i64,
}

impl PolicyRow {
    fn policy(self) -> Result<Policy> {
        Ok(Policy {
            id: row::id("policies.id", self.id)?,
            task_id: row::id("policies.task_id", self.task_id)?,
            job_id: row::id("policies.job_id", self.job_id)?,
            kind: self.kind,
            encoder_id: self.encoder_id.map(|id| row::id("policies.encoder_id", id)).transpose()?,
            dataset_id: self.dataset_id.map(|id| row::id("policies.dataset_id", id)).transpose()?,
            checkpoint: row::id("policies.checkpoint", self.checkpoint)?,
            created_at: Millis(self.created_at),
        })
    }
}

/// Adds a finished policy.
pub(super) async fn insert(tx: &mut Transaction<'_, Sqlite>, policy: &Policy) -> Result<()> {
    sqlx::query(
        "insert into policies (id, task_id, job_id, kind, encoder_id, dataset_id, checkpoint, created_at) \
         values (?, ?, ?, ?, ?, ?, ?, ?)",
    )
    .bind(policy.id.as_str())
    .bind(policy.task_id.as_str())
    .bind(policy.job_id.as_str())
    .bind(&policy.kind)
    .bind(policy.encoder_id.as_ref().map(|id| id.as_str()))
    .bind(policy.dataset_id.as_ref().map(|id| id.as_str()))
    .bind(policy.checkpoint.as_str())
    .bind(policy.created_at.0)
    .execute(&mut **tx)
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
        let found: Option<PolicyRow> = sqlx::query_as("select * from policies where id = ?")
            .bind(id.as_str())
            .fetch_optional(self.read())
            .await
            .map_err(fault("reading a policy"))?;
        match found {
            Some(found) => found.policy(),
            None => Err(self.missing(JobKind::Train, "policy", id.as_str()).await),
        }
    }

    /// A task's policies, newest first.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn policies(&self, task: &TaskId) -> Result<Vec<Policy>> {
        let rows: Vec<PolicyRow> = sqlx::query_as("select * from policies where task_id = ? order by id desc")
            .bind(task.as_str())
            .fetch_all(self.read())
            .await
            .map_err(fault("reading policies"))?;
        rows.into_iter().map(PolicyRow::policy).collect()
    }
}
