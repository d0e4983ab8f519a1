//! Deployments and their history.

use super::{
    Store, fault,
    row::{self, Column, Record as _, record},
    sql::{self, QueryBuilder, Row, Target},
};
use crate::{
    domain::{
        id::TaskId,
        page::Page,
        policy::{Assignment, Deployment, DeploymentChange},
        time::Millis,
    },
    error::{Error, Result},
};

record! { Assignment: policy_id, score_run_id, hide_history }
record! { DeploymentChange: since = "created_at"; assignment }

/// A change with the deployment's name and task.
type Change = (String, TaskId, DeploymentChange);

impl Store {
    /// Points a name at a policy of a task. Repeating the current assignment changes nothing.
    ///
    /// # Errors
    /// Precondition when the name belongs to another task.
    pub(crate) async fn deploy(&self, name: &str, task: &TaskId, assignment: &Assignment) -> Result<Deployment> {
        let mut tx = self.write().await?;
        sql::query("insert into deployments (name, task_id) values ($1, $2) on conflict do nothing")
            .bind(name)
            .bind(task.param())
            .execute(&mut tx)
            .await
            .map_err(fault("adding a deployment"))?;
        let owner: TaskId = sql::query("select task_id from deployments where name = $1")
            .bind(name)
            .try_map(row::read)
            .fetch_one(&mut tx)
            .await
            .map_err(fault("reading a deployment's task"))?;
        if owner != *task {
            return Err(Error::precondition(format!(
                "deployment {name} belongs to {owner}, the policy to {task}; deploy it under another name"
            )));
        }
        sql::query(
            "insert into deployment_changes (name, policy_id, score_run_id, hide_history, created_at, previous) \
             select $1, $2, $3, $4, $5, (select max(id) from deployment_changes where name = $1) where not exists \
             (select 1 from deployment_changes where id = (select max(id) from deployment_changes where name = $1) \
             and policy_id = $2 and score_run_id is not distinct from $3 and hide_history = $4)",
        )
        .bind(name)
        .bind(assignment.policy_id.param())
        .bind(assignment.score_run_id.param())
        .bind(assignment.hide_history)
        .bind(Millis::now().param())
        .execute(&mut tx)
        .await
        .map_err(fault("changing a deployment"))?;
        // Read before the commit, so that a failed read leaves the deployment unchanged.
        let deployment = deployment(&mut tx, name).await?;
        crate::fail_point::pass("deployment.row_written");
        self.commit(tx).await?;
        crate::fail_point::pass("deployment.committed");
        Ok(deployment)
    }

    /// The assignment that rolling a name back would restore.
    ///
    /// # Errors
    /// NotFound; Precondition when there is no earlier assignment.
    pub(crate) async fn before(&self, name: &str) -> Result<Assignment> {
        let before: Vec<Assignment> = sql::query(
            "select earlier.policy_id, earlier.score_run_id, earlier.hide_history from deployment_changes now \
             join deployment_changes earlier on earlier.id = now.previous \
             where now.id = (select max(id) from deployment_changes where name = $1)",
        )
        .bind(name)
        .try_map(row::read)
        .fetch_all(self.read())
        .await
        .map_err(fault("reading a deployment's earlier assignment"))?;
        match before.into_iter().next() {
            Some(assignment) => Ok(assignment),
            None => Err(self.deployment(name).await.map_or_else(|error| error, |_| nothing_before(name))),
        }
    }

    /// Points a name back at its previous policy and score run. The assignment before that is then the next to roll
    /// back to.
    ///
    /// # Errors
    /// NotFound; Precondition when there is no earlier assignment.
    pub(crate) async fn roll_back(&self, name: &str) -> Result<Deployment> {
        let mut tx = self.write().await?;
        let changed = sql::query(
            "insert into deployment_changes (name, policy_id, score_run_id, hide_history, created_at, previous) \
             select $1, earlier.policy_id, earlier.score_run_id, earlier.hide_history, $2, earlier.previous \
             from deployment_changes now \
             join deployment_changes earlier on earlier.id = now.previous \
             where now.id = (select max(id) from deployment_changes where name = $1)",
        )
        .bind(name)
        .bind(Millis::now().param())
        .execute(&mut tx)
        .await
        .map_err(fault("rolling a deployment back"))?;
        let deployment = deployment(&mut tx, name).await?;
        if changed == 0 {
            return Err(nothing_before(name));
        }
        self.commit(tx).await?;
        Ok(deployment)
    }

    /// Deletes a name with its history; the policies stay.
    ///
    /// # Errors
    /// NotFound.
    pub(crate) async fn delete_deployment(&self, name: &str) -> Result<()> {
        let mut tx = self.write().await?;
        sql::query("delete from deployment_changes where name = $1")
            .bind(name)
            .execute(&mut tx)
            .await
            .map_err(fault("deleting the history of a deployment"))?;
        let deleted = sql::query("delete from deployments where name = $1")
            .bind(name)
            .execute(&mut tx)
            .await
            .map_err(fault("deleting a deployment"))?;
        self.commit(tx).await?;
        if deleted == 0 { Err(Error::not_found("deployment", name)) } else { Ok(()) }
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
        let rows = sql::query(
            "select name, task_id, policy_id, score_run_id, hide_history, created_at from deployment_changes join deployments \
             using (name) where $1 is null or task_id = $1 order by name, deployment_changes.id",
        )
        .bind(task.map(Column::param))
        .try_map(change)
        .fetch_all(self.read())
        .await
        .map_err(fault("reading deployments"))?;
        Ok(grouped(rows))
    }

    /// A page of the deployments with their history, by name; of one task, if given, and of these names alone, if given.
    /// With it the name that the next page follows.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn deployments_page(
        &self,
        task: Option<&TaskId>,
        names: Option<&[String]>,
        page: &Page<String>,
    ) -> Result<(Vec<Deployment>, Option<String>)> {
        let mut query = QueryBuilder::new(
            "select name, task_id, policy_id, score_run_id, hide_history, created_at \
             from (select name, task_id from deployments where true",
        );
        if let Some(task) = task {
            query.push(" and task_id = ").push_bind(task.param());
        }
        if let Some(names) = names {
            if names.is_empty() {
                return Ok((Vec::new(), None));
            }
            query.push(" and name in (").push_list(names).push(")");
        }
        if let Some(after) = &page.after {
            query.push(" and name > ").push_bind(after);
        }
        query.push(" order by name limit ").push_bind(page.rows());
        query.push(") as listed join deployment_changes using (name) order by name, deployment_changes.id");
        let rows = query.build().try_map(change).fetch_all(self.read()).await.map_err(fault("listing deployments"))?;
        Ok(page.cut(grouped(rows), |deployment| deployment.name.clone()))
    }
}

/// A deployment with its history, read through this connection.
async fn deployment(from: impl Into<Target<'_>>, name: &str) -> Result<Deployment> {
    let rows = sql::query(
        "select name, task_id, policy_id, score_run_id, hide_history, created_at from deployment_changes join deployments \
         using (name) where name = $1 order by deployment_changes.id",
    )
    .bind(name)
    .try_map(change)
    .fetch_all(from)
    .await
    .map_err(fault("reading a deployment"))?;
    grouped(rows).pop().ok_or_else(|| Error::not_found("deployment", name))
}

fn nothing_before(name: &str) -> Error {
    Error::precondition(format!("deployment {name} has no policy before the one in force; deploy another instead"))
}

fn change(row: Row) -> sqlx::Result<Change> {
    Ok((row::column(&row, "name")?, row::column(&row, "task_id")?, DeploymentChange::decode(&row)?))
}

/// Groups changes, which are sorted by name, into deployments.
fn grouped(changes: Vec<Change>) -> Vec<Deployment> {
    let mut deployments: Vec<Deployment> = Vec::new();
    for (name, task_id, change) in changes {
        match deployments.last_mut() {
            Some(last) if last.name == name => last.history.push(change),
            Some(_) | None => deployments.push(Deployment { task_id, name, history: vec![change] }),
        }
    }
    deployments
}

#[cfg(test)]
mod tests;
