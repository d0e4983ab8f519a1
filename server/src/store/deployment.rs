//! Deployments and their history.

use sqlx::SqliteExecutor;

use super::{Store, fault, row};
use crate::{
    domain::{
        id::{PolicyId, ScoreRunId, TaskId},
        policy::{Deployment, DeploymentChange},
        time::Millis,
    },
    error::{Error, Result},
};

#[derive(sqlx::FromRow)]
struct ChangeRow {
    name: String,
    task_id: String,
    policy_id: String,
    score_run_id: Option<String>,
    created_at: i64,
}

impl Store {
    /// Points a name at a policy of a task and, if one is named, at a score run of that task. Repeating the current
    /// assignment changes nothing.
    ///
    /// # Errors
    /// Precondition when the name belongs to another task.
    pub(crate) async fn deploy(
        &self,
        name: &str,
        task: &TaskId,
        policy: &PolicyId,
        score_run: Option<&ScoreRunId>,
    ) -> Result<Deployment> {
        let mut tx = self.write().await?;
        sqlx::query("insert into deployments (name, task_id) values (?, ?) on conflict do nothing")
            .bind(name)
            .bind(task.as_str())
            .execute(&mut *tx)
            .await
            .map_err(fault("adding a deployment"))?;
        let owner: String = sqlx::query_scalar("select task_id from deployments where name = ?")
            .bind(name)
            .fetch_one(&mut *tx)
            .await
            .map_err(fault("reading a deployment's task"))?;
        if owner != task.as_str() {
            return Err(Error::precondition(format!(
                "deployment {name} belongs to {owner}, the policy to {task}; deploy it under another name"
            )));
        }
        sqlx::query(
            "insert into deployment_changes (name, policy_id, score_run_id, created_at, previous) \
             select ?1, ?2, ?3, ?4, (select max(id) from deployment_changes where name = ?1) where not exists \
             (select 1 from deployment_changes where id = (select max(id) from deployment_changes where name = ?1) \
             and policy_id = ?2 and score_run_id is ?3)",
        )
        .bind(name)
        .bind(policy.as_str())
        .bind(score_run.map(ScoreRunId::as_str))
        .bind(Millis::now().0)
        .execute(&mut *tx)
        .await
        .map_err(fault("changing a deployment"))?;
        // Read before the commit, so that a failed read leaves the deployment unchanged.
        let deployment = deployment(&mut *tx, name).await?;
        crate::fail_point::pass("deployment.row_written");
        self.commit(tx).await?;
        crate::fail_point::pass("deployment.committed");
        Ok(deployment)
    }

    /// The policy and the score run that rolling a name back would restore.
    ///
    /// # Errors
    /// NotFound; Precondition when there is no earlier assignment.
    pub(crate) async fn before(&self, name: &str) -> Result<(PolicyId, Option<ScoreRunId>)> {
        let before: Option<(Option<String>, Option<String>)> = sqlx::query_as(
            "select earlier.policy_id, earlier.score_run_id from deployment_changes now \
             left join deployment_changes earlier on earlier.id = now.previous \
             where now.name = ? order by now.id desc limit 1",
        )
        .bind(name)
        .fetch_optional(self.read())
        .await
        .map_err(fault("reading a deployment's earlier assignment"))?;
        let (policy, score_run) = before.ok_or_else(|| Error::not_found("deployment", name))?;
        let policy = row::id("deployment_changes.policy_id", policy.ok_or_else(|| nothing_before(name))?)?;
        Ok((policy, optional_run(score_run)?))
    }

    /// Points a name back at its previous policy and score run. The assignment before that is then the next to roll
    /// back to.
    ///
    /// # Errors
    /// NotFound; Precondition when there is no earlier assignment.
    pub(crate) async fn roll_back(&self, name: &str) -> Result<Deployment> {
        let mut tx = self.write().await?;
        let changed = sqlx::query(
            "insert into deployment_changes (name, policy_id, score_run_id, created_at, previous) \
             select ?1, earlier.policy_id, earlier.score_run_id, ?2, earlier.previous from deployment_changes now \
             join deployment_changes earlier on earlier.id = now.previous \
             where now.id = (select max(id) from deployment_changes where name = ?1)",
        )
        .bind(name)
        .bind(Millis::now().0)
        .execute(&mut *tx)
        .await
        .map_err(fault("rolling a deployment back"))?;
        let deployment = deployment(&mut *tx, name).await?;
        if changed.rows_affected() == 0 {
            return Err(nothing_before(name));
        }
        self.commit(tx).await?;
        Ok(deployment)
    }

    /// A deployment with its history.
    ///
    /// # Errors
    /// NotFound.
    pub(crate) async fn deployment(&self, name: &str) -> Result<Deployment> {
        deployment(self.read(), name).await
    }

    /// Deployments with their history, by name; of one task, if given.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn deployments(&self, task: Option<&TaskId>) -> Result<Vec<Deployment>> {
        let rows: Vec<ChangeRow> = sqlx::query_as(
            "select name, task_id, policy_id, score_run_id, created_at from deployment_changes join deployments \
             using (name) where ?1 is null or task_id = ?1 order by name, deployment_changes.id",
        )
        .bind(task.map(TaskId::as_str))
        .fetch_all(self.read())
        .await
        .map_err(fault("reading deployments"))?;
        grouped(rows)
    }
}

/// A deployment with its history, read through this connection.
async fn deployment(from: impl SqliteExecutor<'_>, name: &str) -> Result<Deployment> {
    let rows: Vec<ChangeRow> = sqlx::query_as(
        "select name, task_id, policy_id, score_run_id, created_at from deployment_changes join deployments \
         using (name) where name = ? order by deployment_changes.id",
    )
    .bind(name)
    .fetch_all(from)
    .await
    .map_err(fault("reading a deployment"))?;
    grouped(rows)?.pop().ok_or_else(|| Error::not_found("deployment", name))
}

fn nothing_before(name: &str) -> Error {
    Error::precondition(format!("deployment {name} has no policy before the one in force; deploy another instead"))
}

fn optional_run(id: Option<String>) -> Result<Option<ScoreRunId>> {
    id.map(|id| row::id("deployment_changes.score_run_id", id)).transpose()
}

/// Groups changes, which are sorted by name, into deployments.
fn grouped(rows: Vec<ChangeRow>) -> Result<Vec<Deployment>> {
    let mut deployments: Vec<Deployment> = Vec::new();
    for change in rows {
        let policy_id = row::id("deployment_changes.policy_id", change.policy_id)?;
        let score_run_id = optional_run(change.score_run_id)?;
        let change_at = DeploymentChange { policy_id, score_run_id, since: Millis(change.created_at) };
        match deployments.last_mut() {
            Some(last) if last.name == change.name => last.history.push(change_at),
            Some(_) | None => deployments.push(Deployment {
                task_id: row::id("deployments.task_id", change.task_id)?,
                name: change.name,
                history: vec![change_at],
            }),
        }
    }
    Ok(deployments)
}

#[cfg(test)]
mod tests;
