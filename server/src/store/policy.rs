//! Policies.

use super::{
    Store, fault,
    page::newest_first,
    row::{self, Column, Record, column, record, unreadable},
    sql::{self, QueryBuilder, Row, Transaction},
};
use crate::{
    domain::{
        id::{PolicyId, TaskId},
        job::JobKind,
        page::Page,
        policy::{Policy, PolicyOrigin, REMOTE, Training},
        remote::RemotePolicy,
        time::Millis,
    },
    error::Result,
};

record! { Policy: id, task_id, kind, created_at; origin }

impl Record for PolicyOrigin {
    fn decode(row: &Row) -> sqlx::Result<Self> {
        if let Some(remote) = column::<Option<RemotePolicy>>(row, "remote")? {
            return Ok(Self::Remote(Box::new(remote)));
        }
        let present = |name: &str| unreadable(name, "a trained policy has none");
        Ok(Self::Trained(Training {
            job_id: column::<Option<_>>(row, "job_id")?.ok_or_else(|| present("job_id"))?,
            encoder_id: column(row, "encoder_id")?,
            dataset_id: column(row, "dataset_id")?,
            checkpoint: column::<Option<_>>(row, "checkpoint")?.ok_or_else(|| present("checkpoint"))?,
        }))
    }
}

/// Adds a finished or registered policy.
pub(super) async fn insert(tx: &mut Transaction, policy: &Policy) -> Result<()> {
    sql::query(
        "insert into policies (id, task_id, job_id, kind, encoder_id, dataset_id, checkpoint, created_at, remote) \
         values ($1, $2, $3, $4, $5, $6, $7, $8, $9)",
    )
    .bind(policy.id.param())
    .bind(policy.task_id.param())
    .bind(policy.job_id().map(Column::param))
    .bind(&policy.kind)
    .bind(policy.training().and_then(|training| training.encoder_id.as_ref()).map(Column::param))
    .bind(policy.training().and_then(|training| training.dataset_id.as_ref()).map(Column::param))
    .bind(policy.training().map(|training| training.checkpoint.param()))
    .bind(policy.created_at.param())
    .bind(policy.remote().map(Column::param))
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

    /// Registers a policy that another server runs; returns an equal one that the task has.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn register_policy(&self, task: &TaskId, remote: RemotePolicy) -> Result<Policy> {
        let mut tx = self.write().await?;
        let found = sql::query("select * from policies where task_id = $1 and remote = $2")
            .bind(task.param())
            .bind(remote.param())
            .try_map(row::read)
            .fetch_optional(&mut tx)
            .await
            .map_err(fault("looking for a policy"))?;
        if let Some(found) = found {
            return Ok(found);
        }
        let policy = Policy {
            id: PolicyId::new(),
            task_id: task.clone(),
            kind: REMOTE.to_owned(),
            origin: PolicyOrigin::Remote(Box::new(remote)),
            created_at: Millis::now(),
        };
        insert(&mut tx, &policy).await?;
        self.commit(tx).await?;
        Ok(policy)
    }

    /// A task's policies, newest first.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn policies(&self, task: &TaskId) -> Result<Vec<Policy>> {
        Ok(self.policies_page(task, &Page::whole()).await?.0)
    }

    /// A page of a task's policies, newest first, and the policy that the next one follows.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn policies_page(
        &self,
        task: &TaskId,
        page: &Page<PolicyId>,
    ) -> Result<(Vec<Policy>, Option<PolicyId>)> {
        let mut query = QueryBuilder::new("select * from policies where task_id = ");
        query.push_bind(task.param());
        let found = newest_first(self.read(), query, page, |policy: &Policy| policy.id.clone()).await;
        found.map_err(fault("reading policies"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        domain::remote::Protocol,
        error::Kind,
        store::testing::{self, results},
    };

    fn remote(address: &str) -> RemotePolicy {
        RemotePolicy {
            protocol: Protocol::Openpi,
            address: address.into(),
            model: String::new(),
            model_version: String::new(),
            inputs: Vec::new(),
            output: "actions".into(),
            chunk_length: 10,
            execute_length: 5,
            sequences: false,
            answer_within_ms: 500,
            source: "a lab".into(),
        }
    }

    #[tokio::test]
    async fn an_equal_policy_is_registered_once() {
        let (_dir, store) = testing::store().await;
        let task = testing::task(&store).await;
        let one = store.register_policy(&task.id, remote("ws://a:1")).await.unwrap();
        let same = store.register_policy(&task.id, remote("ws://a:1")).await.unwrap();
        let other = store.register_policy(&task.id, remote("ws://b:1")).await.unwrap();
        assert_eq!((&one.id, one.remote()), (&same.id, Some(&remote("ws://a:1"))));
        let listed: Vec<_> = store.policies(&task.id).await.unwrap().into_iter().map(|policy| policy.id).collect();
        assert_eq!(listed, [other.id, one.id.clone()]);
        assert_eq!(store.policy(&one.id).await.unwrap().remote(), Some(&remote("ws://a:1")));
        assert_eq!(store.policy(&PolicyId::new()).await.unwrap_err().kind(), Kind::NotFound);
    }

    #[tokio::test]
    async fn a_policy_is_trained_here_or_remote() {
        use crate::domain::episode::Outcome;
        let (_dir, store) = testing::store().await;
        let task = testing::task(&store).await;
        for outcome in [Outcome::Success, Outcome::Failure] {
            testing::episode(&store, &task, outcome, "").await;
        }
        let encoder = results::encoder(&store, &task).await;
        let trained = results::policy(&store, &task, &encoder, blake3::hash(b"policy").into()).await;
        let read = store.policy(&trained.id).await.unwrap();
        assert_eq!((read.job_id(), read.remote()), (trained.job_id(), None));
        let registered = store.register_policy(&task.id, remote("ws://a:1")).await.unwrap();
        assert!(registered.training().is_none());
        // Nothing of it is described by a sidecar or kept as a blob.
        let queued = store.undescribed(None, 99).await.unwrap();
        let queued = |id: &str| queued.iter().any(|row| row.id == id);
        assert!(queued(trained.id.as_str()) && !queued(registered.id.as_str()));
        assert_eq!(store.wrong_rows().await.unwrap().into_iter().find(|(id, _)| *id == registered.id.as_str()), None);
    }
}
