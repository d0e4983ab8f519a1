//! Deployments and their history.

use super::{Store, commit, fault, row};
use crate::{
    domain::{
        id::{PolicyId, TaskId},
        policy::Deployment,
        time::Millis,
    },
    error::{Error, Result},
};

#[derive(sqlx::FromRow)]
struct ChangeRow {
    name: String,
    task_id: String,
    policy_id: String,
    created_at: i64,
}

impl Store {
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
            "insert into deployment_changes (name, policy_id, created_at, previous) select ?1, ?2, ?3, \
             (select max(id) from deployment_changes where name = ?1) where ?2 is not \
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

    /// The policy that rolling a name back would point it at.
    ///
    /// # Errors
    /// NotFound; Precondition when there is nothing before.
    pub(crate) async fn before(&self, name: &str) -> Result<PolicyId> {
        let before: Option<Option<String>> = sqlx::query_scalar(
            "select earlier.policy_id from deployment_changes now \
             left join deployment_changes earlier on earlier.id = now.previous \
             where now.name = ? order by now.id desc limit 1",
        )
        .bind(name)
        .fetch_optional(self.read())
        .await
        .map_err(fault("reading what a deployment was before"))?;
        let before = before.ok_or_else(|| Error::not_found("deployment", name))?;
        row::id("deployment_changes.policy_id", before.ok_or_else(|| nothing_before(name))?)
    }

    /// Points a name back at the policy before. What was before that is then next to roll back to.
    ///
    /// # Errors
    /// NotFound; Precondition when there is nothing before.
    pub(crate) async fn roll_back(&self, name: &str) -> Result<Deployment> {
        let mut tx = self.write().await?;
        let changed = sqlx::query(
            "insert into deployment_changes (name, policy_id, created_at, previous) \
             select ?1, earlier.policy_id, ?2, earlier.previous from deployment_changes now \
             join deployment_changes earlier on earlier.id = now.previous \
             where now.id = (select max(id) from deployment_changes where name = ?1)",
        )
        .bind(name)
        .bind(Millis::now().0)
        .execute(&mut *tx)
        .await
        .map_err(fault("rolling a deployment back"))?;
        commit(tx).await?;
        let deployment = self.deployment(name).await?;
        if changed.rows_affected() == 0 {
            return Err(nothing_before(name));
        }
        Ok(deployment)
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

fn nothing_before(name: &str) -> Error {
    Error::precondition(format!("deployment {name} has no policy before the one in force; deploy another instead"))
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

    #[tokio::test]
    async fn rolling_back_walks_what_was_deployed() {
        let (_dir, store) = testing::store().await;
        let task = testing::task(&store).await;
        testing::episode(&store, &task, Outcome::Success, "").await;
        testing::episode(&store, &task, Outcome::Failure, "").await;
        let encoder = results::encoder(&store, &task).await;
        let mut made = Vec::new();
        for _ in 0..4 {
            made.push(results::policy(&store, &task, &encoder, blake3::hash(b"policy").into()).await.id);
        }
        let back = async || store.roll_back("arm").await.map(|deployment| deployment.policy_id().cloned().unwrap());

        assert_eq!(back().await.unwrap_err().kind(), Kind::NotFound);
        assert_eq!(store.before("arm").await.unwrap_err().kind(), Kind::NotFound);
        for policy in &made[..3] {
            store.deploy("arm", &task.id, policy).await.unwrap();
        }
        assert_eq!(store.before("arm").await.unwrap(), made[1]);
        assert_eq!(back().await.unwrap(), made[1]);
        assert_eq!(back().await.unwrap(), made[0], "twice goes two back, not to and fro");
        assert_eq!(back().await.unwrap_err().kind(), Kind::Precondition);
        assert_eq!(store.before("arm").await.unwrap_err().kind(), Kind::Precondition);

        store.deploy("arm", &task.id, &made[3]).await.unwrap();
        assert_eq!(back().await.unwrap(), made[0], "what is deployed anew goes on from there");
        let history = store.deployment("arm").await.unwrap().history;
        let kept: Vec<_> = history.into_iter().map(|(policy, _)| policy).collect();
        assert_eq!(kept, [0, 1, 2, 1, 0, 3, 0].map(|index: usize| made[index].clone()), "nothing is forgotten");
    }
}
