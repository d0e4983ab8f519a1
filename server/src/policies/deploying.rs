//! Names that point at policies: deployed, rolled back, deleted, and followed when another server did so.

use gleaner_learn::LiveScorer;
use tracing::Instrument as _;

use super::{Policies, lock::lock};
use crate::{
    domain::{
        id::ScoreRunId,
        policy::{Assignment, Deployment, Policy},
    },
    error::{Error, Kind, Result},
    scorers::Held,
};

impl Policies {
    /// Points a name at a policy and, if one is named, at the score run for its live scores, once both are loaded and
    /// the policy has answered a blank observation. Running sessions keep their policy.
    ///
    /// # Errors
    /// NotFound; Invalid when the run belongs to another task, or the history is to be hidden from a policy that has none or
    /// always saw it in training; Precondition when the policy or the run is not finished or cannot be used by this version,
    /// the run cannot score live, or the name belongs to another task.
    pub(crate) async fn deploy(&self, name: &str, assignment: Assignment) -> Result<Deployment> {
        let policy = self.0.store.policy(&assignment.policy_id).await?;
        // Before the lock: the scorer and the policy's own server take long.
        let scorer = self.scorer(&policy, assignment.score_run_id.as_ref()).await?;
        self.check(&policy, assignment.hide_history).await?;
        let (policies, name) = (self.clone(), name.to_owned());
        move_to_end(async move {
            let _scorer = scorer;
            let _moving = policies.0.moving.lock().await;
            let engine = policies.load(&policy, assignment.hide_history).await?;
            engine.expect_history()?;
            let deployment = policies.0.store.deploy(&name, &policy.task_id, &assignment).await?;
            lock(&policies.0.loaded).point(&name, &engine);
            tracing::info!(deployment.name = name, policy.id = %policy.id, "policy deployed");
            Ok(deployment)
        })
        .await
    }

    /// Points a name back at its previous policy and score run, once both are loaded.
    ///
    /// # Errors
    /// NotFound; Precondition when there is no previous policy, or its checkpoint cannot be read by this version.
    pub(crate) async fn roll_back(&self, name: &str) -> Result<Deployment> {
        // Before the lock: the scorer and the policy's own server take long.
        let before = self.0.store.before(name).await?;
        let policy = self.0.store.policy(&before.policy_id).await?;
        let scorer = self.scorer(&policy, before.score_run_id.as_ref()).await?;
        self.check(&policy, before.hide_history).await?;
        let (policies, name) = (self.clone(), name.to_owned());
        move_to_end(async move {
            let (_scorer, store) = (scorer, &policies.0.store);
            let _moving = policies.0.moving.lock().await;
            let before = store.before(&name).await?;
            let engine = policies.load(&store.policy(&before.policy_id).await?, before.hide_history).await?;
            let deployment = store.roll_back(&name).await?;
            lock(&policies.0.loaded).point(&name, &engine);
            tracing::info!(deployment.name = name, policy.id = %before.policy_id, "deployment rolled back");
            Ok(deployment)
        })
        .await
    }

    /// Deletes a name with its history. Running sessions keep their policy; it is unloaded with the last of them.
    ///
    /// # Errors
    /// NotFound.
    pub(crate) async fn delete(&self, name: &str) -> Result<()> {
        let (policies, name) = (self.clone(), name.to_owned());
        move_to_end(async move {
            let _moving = policies.0.moving.lock().await;
            policies.0.store.delete_deployment(&name).await?;
            lock(&policies.0.loaded).forget(&name);
            tracing::info!(deployment.name = name, "deployment deleted");
            Ok(())
        })
        .await
    }

    /// The score run for live scores, loaded. Once it is dropped, idle runs above the budget are unloaded.
    async fn scorer(&self, policy: &Policy, score_run: Option<&ScoreRunId>) -> Result<Option<Held<LiveScorer>>> {
        let Some(run) = score_run else { return Ok(None) };
        let task = self.0.store.score_run(run).await?.task_id;
        if task != policy.task_id {
            let of = &policy.task_id;
            return Err(Error::invalid("score_run_id", format!("{run} belongs to {task}, the policy to {of}")));
        }
        Ok(Some(self.0.scorers.load(run).await?.held()))
    }

    /// Points each loaded name at the policy that the database has for it, and removes the names that it does not have:
    /// another server may have moved or deleted them. Running sessions keep their policy.
    pub(crate) async fn follow_deployments(&self) {
        let names = lock(&self.0.loaded).names();
        for (name, key) in names {
            let now = match self.0.store.deployment(&name).await {
                Ok(stored) => stored.assignment().map(|now| (now.policy_id.clone(), now.hide_history)),
                Err(error) if error.kind() == Kind::NotFound => None,
                Err(_) => continue,
            };
            if now.as_ref() == Some(&key) {
                continue;
            }
            let _moving = self.0.moving.lock().await;
            match self.as_stored(&name).await {
                Ok((engine, _)) => {
                    tracing::info!(deployment.name = name, policy.id = %engine.identity().policy_id, "deployment moved by another server");
                }
                Err(error) if error.kind() == Kind::NotFound => {
                    lock(&self.0.loaded).forget(&name);
                    tracing::info!(deployment.name = name, "deployment deleted by another server");
                }
                Err(error) => tracing::warn!(%error, deployment.name = name, "a moved deployment cannot be loaded"),
            }
        }
    }
}

/// Moves or deletes a deployment to the end even if the caller is gone: the stored policy and the served one must be the
/// same.
pub(super) async fn move_to_end<T: Send + 'static>(
    moving: impl Future<Output = Result<T>> + Send + 'static,
) -> Result<T> {
    let moved = tokio::spawn(moving.in_current_span()).await;
    moved.map_err(|error| Error::internal("moving a deployment", error))?
}
