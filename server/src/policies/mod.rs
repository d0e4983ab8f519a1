//! Policies in service: loading, deployment names, and the sessions that use them.
//!
//! A policy is loaded when it is deployed or first requested, and stays in memory while a deployment points at it or a
//! session holds it. Must not depend on wire types or SQL.

mod act;
mod batch;
mod engine;
mod inference_step;
mod live;
mod loaded_policies;
mod lock;
mod model;
pub(crate) mod observation;
mod open_session;
mod pending_reply;
mod record;
mod remote;
mod remote_history;
mod reply_sender;
mod sequences;
mod session;
mod session_rates;
mod spin_wait;
mod stages;
#[cfg(test)]
mod testing;
#[cfg(test)]
mod tests;

use std::{
    sync::{Arc, Mutex},
    time::Duration,
};

use gleaner_learn::{LiveScorer, Policy as Model};
use gleaner_remote::Outgoing;
use tracing::Instrument as _;

use self::{
    engine::{Engine, Identity},
    live::Live,
    loaded_policies::LoadedPolicies,
    lock::lock,
    sequences::Sequences,
};
use crate::{
    blobs::Blobs,
    config::ServeConfig,
    domain::{
        id::{ScoreRunId, SessionId},
        live::{LiveSession, SessionState},
        observation::{Acted, Observation},
        policy::{Assignment, Deployment, Policy, PolicyOrigin, Training},
    },
    error::{Error, Result},
    rollouts::Rollouts,
    scorers::{Held, Scorers},
    store::Store,
};

/// All loaded policies; clones share them.
#[derive(Clone)]
pub struct Policies(Arc<Inner>);

struct Inner {
    config: Arc<ServeConfig>,
    store: Store,
    blobs: Blobs,
    scorers: Scorers,
    rollouts: Rollouts,
    loaded: Mutex<LoadedPolicies<Model>>,
    sequences: Sequences<Model>,
    live: Live,
    /// Which other servers may be called for policies, and how.
    outgoing: Outgoing,
    /// Held while a policy is loaded or a name is moved, so that a slow first use cannot undo a deployment.
    moving: tokio::sync::Mutex<()>,
}

impl Policies {
    /// Loads no policy yet.
    pub fn new(config: &Arc<ServeConfig>, store: Store, blobs: Blobs, scorers: Scorers, rollouts: Rollouts) -> Self {
        Self(Arc::new(Inner {
            config: Arc::clone(config),
            outgoing: remote::outgoing(&config.policy_servers),
            store,
            blobs,
            scorers,
            rollouts,
            loaded: Mutex::new(LoadedPolicies::new(config.policies.policy_memory_bytes)),
            sequences: Sequences::default(),
            live: Live::default(),
            moving: tokio::sync::Mutex::default(),
        }))
    }

    /// Unloads every policy: queued requests are answered, later ones are refused.
    pub async fn stop(&self) {
        let _moving = self.0.moving.lock().await;
        let engines = lock(&self.0.loaded).stop();
        let closing = tokio::task::spawn_blocking(move || engines.iter().for_each(|engine| engine.close()));
        if let Err(error) = closing.await {
            tracing::error!(%error, "unloading policies failed");
        }
    }

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

    /// One action from a window of observations that the client keeps, oldest first.
    ///
    /// # Errors
    /// NotFound; Invalid naming the field; Exhausted when the queue is full; Late when the deadline passes first.
    pub(crate) async fn act(&self, deployment: &str, observations: Vec<Observation>) -> Result<Acted> {
        let engine = self.deployed(deployment).await?;
        act::act(&engine, observations).await
    }

    /// The running sessions and their state, the newest first.
    pub(crate) fn live(&self) -> Vec<(LiveSession, SessionState)> {
        self.0.live.all()
    }

    /// A running session and its state.
    ///
    /// # Errors
    /// NotFound when no such session is running.
    pub(crate) fn live_session(&self, id: &SessionId) -> Result<(LiveSession, SessionState)> {
        self.0.live.one(id).ok_or_else(|| Error::not_found("running session", id))
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

    /// Points each loaded name at the policy that the database has for it: another server may have moved it. Running
    /// sessions keep their policy.
    pub(crate) async fn follow_deployments(&self) {
        let names = lock(&self.0.loaded).names();
        for (name, key) in names {
            let Ok(stored) = self.0.store.deployment(&name).await else { continue };
            let now = stored.assignment().map(|now| (now.policy_id.clone(), now.hide_history));
            if now.as_ref() == Some(&key) {
                continue;
            }
            let _moving = self.0.moving.lock().await;
            match self.as_stored(&name).await {
                Ok((engine, _)) => {
                    tracing::info!(deployment.name = name, policy.id = %engine.identity().policy_id, "deployment moved by another server");
                }
                Err(error) => tracing::warn!(%error, deployment.name = name, "a moved deployment cannot be loaded"),
            }
        }
    }

    /// The policy that a name points at; loads it if needed.
    async fn deployed(&self, name: &str) -> Result<Arc<Engine<Model>>> {
        let find = || lock(&self.0.loaded).named(name);
        if let Some(engine) = find() {
            return Ok(engine);
        }
        let _moving = self.0.moving.lock().await;
        if let Some(engine) = find() {
            return Ok(engine);
        }
        Ok(self.as_stored(name).await?.0)
    }

    /// Points a name at the policy in the store; loads it if needed. Requires `moving` to be held.
    async fn as_stored(&self, name: &str) -> Result<(Arc<Engine<Model>>, Deployment)> {
        let deployment = self.0.store.deployment(name).await?;
        let now = deployment.assignment().ok_or_else(|| Error::not_found("deployment", name))?;
        let engine = self.load(&self.0.store.policy(&now.policy_id).await?, now.hide_history).await?;
        lock(&self.0.loaded).point(name, &engine);
        Ok((engine, deployment))
    }

    /// The policy's engine, with its history shown or hidden; loads it if needed. Requires `moving` to be held.
    async fn load(&self, policy: &Policy, hide_history: bool) -> Result<Arc<Engine<Model>>> {
        if let Some(engine) = lock(&self.0.loaded).loaded(&(policy.id.clone(), hide_history))? {
            return Ok(engine);
        }
        let task = self.0.store.task_by_id(&policy.task_id).await?;
        let config = &self.0.config.policies;
        let identity = Identity {
            policy_id: policy.id.clone(),
            hide_history,
            task_id: policy.task_id.clone(),
            batch: config.policy_batch,
            queue: config.policy_queue,
            period: Duration::from_secs_f64(1.0 / task.spec.rate_hz),
            wait: config.policy_batch_wait,
            spin: config.policy_spin(),
        };
        let (engine, bytes) = match &policy.origin {
            PolicyOrigin::Trained(training) => self.start(identity, training).await?,
            // It is called at its first observation, so that a session opens although its server is down.
            PolicyOrigin::Remote(remote) => {
                (remote::engine(identity, self.remote(remote, &task)?, remote.execute_length, &task)?, 0)
            }
        };
        lock(&self.0.loaded).put(&engine, bytes);
        Ok(engine)
    }

    /// Starts a trained policy; returns the size of its checkpoint too.
    async fn start(&self, identity: Identity, training: &Training) -> Result<(Arc<Engine<Model>>, u64)> {
        let (blobs, checkpoint) = (self.0.blobs.clone(), training.checkpoint.clone());
        let sizing = tokio::task::spawn_blocking(move || blobs.size(&checkpoint)).await;
        let bytes = sizing.map_err(|error| Error::internal("reading a policy's size", error))??.unwrap_or(0);
        lock(&self.0.loaded).make_room(bytes);
        let (blobs, checkpoint) = (self.0.blobs.clone(), training.checkpoint.clone());
        let hide_history = identity.hide_history;
        let load = move || {
            let policy = Model::load(&blobs.get(&checkpoint)?).map_err(model::learned)?;
            if hide_history { policy.hiding_history().map_err(model::learned) } else { Ok(policy) }
        };
        Ok((Engine::start(identity, load).await?, bytes))
    }
}

/// Moves a deployment to the end even if the caller is gone: the stored policy and the served one must be the same.
async fn move_to_end(moving: impl Future<Output = Result<Deployment>> + Send + 'static) -> Result<Deployment> {
    let moved = tokio::spawn(moving.in_current_span()).await;
    moved.map_err(|error| Error::internal("moving a deployment", error))?
}
