//! Serving policies: which are loaded, under which names, and the sessions that use them.
//!
//! A policy is loaded when it is deployed or first asked for, and kept while a deployment points at it or a session
//! holds it. Knows no wire type and no SQL.

mod attend;
mod batch;
mod due;
mod engine;
mod live;
mod model;
pub(crate) mod observation;
mod once;
mod outlet;
mod pace;
mod record;
mod sequences;
mod session;
mod shelf;
mod stages;
#[cfg(test)]
mod testing;
#[cfg(test)]
mod tests;
mod turn;
mod vigil;

use std::{
    sync::{Arc, Mutex},
    time::Duration,
};

use gleaner_learn::Policy as Model;
use tracing::Instrument as _;

pub(crate) use self::live::{LiveSession, Now};
use self::{
    engine::{Engine, Identity, lock},
    live::Live,
    sequences::Sequences,
    shelf::Shelf,
};
use crate::{
    blobs::Blobs,
    config::ServeConfig,
    domain::{
        id::{PolicyId, ScoreRunId, SessionId},
        observation::{Acted, Observation},
        policy::{Deployment, Policy},
    },
    error::{Error, Result},
    rollouts::Rollouts,
    scorers::{Ready, Scorers},
    store::Store,
};

/// Every loaded policy; clones share them.
#[derive(Clone)]
pub struct Policies(Arc<Inner>);

struct Inner {
    config: Arc<ServeConfig>,
    store: Store,
    blobs: Blobs,
    scorers: Scorers,
    rollouts: Rollouts,
    shelf: Mutex<Shelf<Model>>,
    sequences: Sequences<Model>,
    live: Live,
    /// Held while a policy is loaded or a name is moved, so that a slow first use cannot undo a deployment.
    moving: tokio::sync::Mutex<()>,
}

impl Policies {
    /// Loads nothing yet.
    pub fn new(config: &Arc<ServeConfig>, store: Store, blobs: Blobs, scorers: Scorers, rollouts: Rollouts) -> Self {
        Self(Arc::new(Inner {
            config: Arc::clone(config),
            store,
            blobs,
            scorers,
            rollouts,
            shelf: Mutex::new(Shelf::new(config.policies.policy_memory_bytes)),
            sequences: Sequences::default(),
            live: Live::default(),
            moving: tokio::sync::Mutex::default(),
        }))
    }

    /// Unloads every policy: what waits is answered, what comes later is refused.
    pub async fn stop(&self) {
        let _moving = self.0.moving.lock().await;
        let engines = lock(&self.0.shelf).stop();
        let closing = tokio::task::spawn_blocking(move || engines.iter().for_each(|engine| engine.close()));
        if let Err(error) = closing.await {
            tracing::error!(%error, "unloading policies failed");
        }
    }

    /// Points a name at a policy, once it is loaded and has answered, and at the run that scores what it does, if one
    /// is named, once that is ready. Running sessions keep theirs.
    ///
    /// # Errors
    /// NotFound; Invalid when the run is another task's; Precondition when the policy or the run is not finished,
    /// cannot be used by this version, the run cannot score live, or the name belongs to another task.
    pub(crate) async fn deploy(
        &self,
        name: &str,
        policy: &PolicyId,
        score_run: Option<&ScoreRunId>,
    ) -> Result<Deployment> {
        let policy = self.0.store.policy(policy).await?;
        let scorer = self.scorer(&policy, score_run).await?;
        let (policies, name, score_run) = (self.clone(), name.to_owned(), score_run.cloned());
        whole(async move {
            let _scorer = scorer;
            let _moving = policies.0.moving.lock().await;
            let engine = policies.load(&policy).await?;
            let deployment = policies.0.store.deploy(&name, &policy.task_id, &policy.id, score_run.as_ref()).await?;
            lock(&policies.0.shelf).point(&name, &engine);
            tracing::info!(deployment.name = name, policy.id = %policy.id, "policy deployed");
            Ok(deployment)
        })
        .await
    }

    /// Points a name back at the policy it pointed at before, and its score run, once both are loaded.
    ///
    /// # Errors
    /// NotFound; Precondition when there is nothing before, or its checkpoint cannot be read by this version.
    pub(crate) async fn roll_back(&self, name: &str) -> Result<Deployment> {
        // Before anything is held: a scorer takes long to load.
        let (policy, score_run) = self.0.store.before(name).await?;
        let scorer = self.scorer(&self.0.store.policy(&policy).await?, score_run.as_ref()).await?;
        let (policies, name) = (self.clone(), name.to_owned());
        whole(async move {
            let (_scorer, store) = (scorer, &policies.0.store);
            let _moving = policies.0.moving.lock().await;
            let policy = store.policy(&store.before(&name).await?.0).await?;
            let engine = policies.load(&policy).await?;
            let deployment = store.roll_back(&name).await?;
            lock(&policies.0.shelf).point(&name, &engine);
            tracing::info!(deployment.name = name, policy.id = %policy.id, "deployment rolled back");
            Ok(deployment)
        })
        .await
    }

    /// One action from a window of observations that the caller keeps, oldest first.
    ///
    /// # Errors
    /// NotFound; Invalid naming the field; Exhausted when too many wait; Late when the deadline passes first.
    pub(crate) async fn act(&self, deployment: &str, observations: Vec<Observation>) -> Result<Acted> {
        let engine = self.deployed(deployment).await?;
        once::once(&engine, observations).await
    }

    /// The sessions that run, the newest first, and how each stands.
    pub(crate) fn live(&self) -> Vec<(LiveSession, Now)> {
        self.0.live.all()
    }

    /// A session that runs, and how it stands.
    ///
    /// # Errors
    /// NotFound when it does not, or not any more.
    pub(crate) fn live_session(&self, id: &SessionId) -> Result<(LiveSession, Now)> {
        self.0.live.one(id).ok_or_else(|| Error::not_found("session that runs", id))
    }

    /// The run that is to score what a policy does, ready.
    async fn scorer(&self, policy: &Policy, score_run: Option<&ScoreRunId>) -> Result<Option<Arc<Ready>>> {
        let Some(run) = score_run else { return Ok(None) };
        let task = self.0.store.score_run(run).await?.task_id;
        if task != policy.task_id {
            let of = &policy.task_id;
            return Err(Error::invalid("score_run_id", format!("{run} belongs to {task}, the policy to {of}")));
        }
        self.0.scorers.load(run).await.map(Some)
    }

    /// The policy that a name points at, loaded now if it is not yet.
    async fn deployed(&self, name: &str) -> Result<Arc<Engine<Model>>> {
        let find = || lock(&self.0.shelf).named(name);
        if let Some(engine) = find() {
            return Ok(engine);
        }
        let _moving = self.0.moving.lock().await;
        if let Some(engine) = find() {
            return Ok(engine);
        }
        Ok(self.as_stored(name).await?.0)
    }

    /// Points a name at the policy that the store says, loaded now if it is not yet. Only with `moving` held.
    async fn as_stored(&self, name: &str) -> Result<(Arc<Engine<Model>>, Deployment)> {
        let deployment = self.0.store.deployment(name).await?;
        let id = deployment.policy_id().ok_or_else(|| Error::not_found("deployment", name))?;
        let engine = self.load(&self.0.store.policy(id).await?).await?;
        lock(&self.0.shelf).point(name, &engine);
        Ok((engine, deployment))
    }

    /// The policy's engine: the one that is loaded, or a new one. Only with `moving` held.
    async fn load(&self, policy: &Policy) -> Result<Arc<Engine<Model>>> {
        if let Some(engine) = lock(&self.0.shelf).loaded(&policy.id)? {
            return Ok(engine);
        }
        let bytes = tokio::fs::metadata(self.0.blobs.path(&policy.checkpoint)).await.map_or(0, |file| file.len());
        lock(&self.0.shelf).make_room(bytes);
        let config = &self.0.config.policies;
        let identity = Identity {
            policy_id: policy.id.clone(),
            task_id: policy.task_id.clone(),
            batch: config.policy_batch,
            queue: config.policy_queue,
            period: Duration::from_secs_f64(1.0 / self.0.store.task_by_id(&policy.task_id).await?.spec.rate_hz),
            wait: config.policy_batch_wait,
            awake: config.policy_awake(),
        };
        let (blobs, checkpoint) = (self.0.blobs.clone(), policy.checkpoint.clone());
        let engine =
            Engine::start(identity, move || Model::load(&blobs.get(&checkpoint)?).map_err(model::learned)).await?;
        lock(&self.0.shelf).put(&engine, bytes);
        Ok(engine)
    }
}

/// A move of a deployment, done to its end even if whoever asked for it has gone: what is stored and what is served
/// must be the same.
async fn whole(moving: impl Future<Output = Result<Deployment>> + Send + 'static) -> Result<Deployment> {
    let moved = tokio::spawn(moving.in_current_span()).await;
    moved.map_err(|error| Error::internal("moving a deployment", error))?
}
