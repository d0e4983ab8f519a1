//! Policies, deployments and their history.

use sqlx::{Sqlite, Transaction};

use super::{Store, commit, fault, row};
use crate::{
    domain::{
        id::{PolicyId, TaskId},
        job::JobKind,
        policy::{Deployment, Policy},
        time::Millis,
    },
    error::{Error, Result},
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

#[derive(sqlx::FromRow)]
struct ChangeRow {
    name: String,
    task_id: String,
    policy_id: String,
    created_at: i64,
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

    /// Points a name at a policy of a task. Naming the policy in force again changes nothing.
    ///
    /// # Errors
    /// Precondition when the name belongs to another task.
    pub(crate) async fn deploy(&self, name: &str, task: &TaskId, policy: &PolicyId) -> Result<Deployment> {
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
            "insert into deployment_changes (name, policy_id, created_at) select ?1, ?2, ?3 where ?2 is not \
             (select policy_id from deployment_changes where name = ?1 order by id desc limit 1)",
        )
        .bind(name)
        .bind(policy.as_str())
        .bind(Millis::now().0)
        .execute(&mut *tx)
        .await
        .map_err(fault("changing a deployment"))?;
        commit(tx).await?;
        self.deployment(name).await
    }

    /// A deployment with its history.
    ///
    /// # Errors
    /// NotFound.
    pub(crate) async fn deployment(&self, name: &str) -> Result<Deployment> {
        let rows: Vec<ChangeRow> = sqlx::query_as(
            "select name, task_id, policy_id, created_at from deployment_changes join deployments using (name) \
             where name = ? order by deployment_changes.id",
        )
        .bind(name)
        .fetch_all(self.read())
        .await
        .map_err(fault("reading a deployment"))?;
        grouped(rows)?.pop().ok_or_else(|| Error::not_found("deployment", name))
    }

    /// Deployments with their history, by name; of one task, if given.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn deployments(&self, task: Option<&TaskId>) -> Result<Vec<Deployment>> {
        let rows: Vec<ChangeRow> = sqlx::query_as(
            "select name, task_id, policy_id, created_at from deployment_changes join deployments using (name) \
             where ?1 is null or task_id = ?1 order by name, deployment_changes.id",
        )
        .bind(task.map(TaskId::as_str))
        .fetch_all(self.read())
        .await
        .map_err(fault("reading deployments"))?;
        grouped(rows)
    }
}

/// Puts changes, which come sorted by name, together as deployments.
fn grouped(rows: Vec<ChangeRow>) -> Result<Vec<Deployment>> {
    let mut deployments: Vec<Deployment> = Vec::new();
    for change in rows {
        let policy = row::id("deployment_changes.policy_id", change.policy_id)?;
        let change_at = (policy, Millis(change.created_at));
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
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::{
        domain::episode::Outcome,
        error::Kind,
        store::testing::{self, results},
    };

    #[tokio::test]
    async fn a_deployment_remembers_what_it_pointed_at() {
        let (_dir, store) = testing::store().await;
        let task = testing::task(&store).await;
        testing::episode(&store, &task, Outcome::Success, "").await;
        testing::episode(&store, &task, Outcome::Failure, "").await;
        let encoder = results::encoder(&store, &task).await;
        let blob = || blake3::hash(b"policy").into();
        let first = results::policy(&store, &task, &encoder, blob()).await.id;
        let second = results::policy(&store, &task, &encoder, blob()).await.id;

        assert_eq!(store.deployment("arm@prod").await.unwrap_err().kind(), Kind::NotFound);
        for policy in [&first, &second, &second, &first] {
            store.deploy("arm@prod", &task.id, policy).await.unwrap();
        }
        store.deploy("arm@test", &task.id, &second).await.unwrap();

        let deployment = store.deployment("arm@prod").await.unwrap();
        let history: Vec<_> = deployment.history.iter().map(|(policy, _)| policy.clone()).collect();
        assert_eq!(history, [first.clone(), second.clone(), first.clone()], "deploying it again is no change");
        assert_eq!(deployment.policy_id(), Some(&first));
        let all = store.deployments(None).await.unwrap();
        assert_eq!(all.iter().map(|one| one.name.as_str()).collect::<Vec<_>>(), ["arm@prod", "arm@test"]);
        assert_eq!(store.deployments(Some(&task.id)).await.unwrap().len(), 2);
        assert!(store.deployments(Some(&TaskId::new())).await.unwrap().is_empty());
        let newest_first: Vec<_> = store.policies(&task.id).await.unwrap().into_iter().map(|one| one.id).collect();
        assert_eq!(newest_first, [second, first]);
    }

    #[tokio::test]
    async fn a_name_stays_with_its_task() {
        let (_dir, store) = testing::store().await;
        let task = testing::task(&store).await;
        testing::episode(&store, &task, Outcome::Success, "").await;
        testing::episode(&store, &task, Outcome::Failure, "").await;
        let encoder = results::encoder(&store, &task).await;
        let policy = results::policy(&store, &task, &encoder, blake3::hash(b"policy").into()).await;
        store.deploy("arm@prod", &task.id, &policy.id).await.unwrap();
        let mut spec = testing::spec();
        spec.name = "other".into();
        let other = store.insert_task(&spec).await.unwrap();

        let error = store.deploy("arm@prod", &other.id, &policy.id).await.unwrap_err();
        assert_eq!(error.kind(), Kind::Precondition);
        assert_eq!(store.deployment("arm@prod").await.unwrap().history.len(), 1, "nothing was written");
    }
}
