//! Policies in service: loading, deployment names, and the sessions that use them.
//!
//! A policy is loaded when it is deployed or first requested, and stays in memory while a deployment points at it or a
//! session holds it. Must not depend on wire types or SQL.

mod act;
mod batch;
mod deploying;
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
mod waiting;

use std::{
    sync::{Arc, Mutex},
    time::Duration,
};

use gleaner_learn::Policy as Model;
use gleaner_remote::Outgoing;

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
        id::SessionId,
        live::{LiveSession, SessionState},
        observation::{Acted, Observation},
        policy::{Deployment, Policy, PolicyOrigin, Training},
    },
    error::{Error, Result},
    rollouts::Rollouts,
    scorers::Scorers,
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
