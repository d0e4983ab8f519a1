//! Serving policies: which are loaded, under which names, and the sessions that use them.
//!
//! A policy is loaded when it is deployed or first asked for, and kept while a deployment points at it or a session
//! holds it. Knows no wire type and no SQL.

mod batch;
mod due;
mod engine;
mod model;
mod observation;
mod once;
mod outlet;
mod pace;
mod sequences;
mod session;
mod shelf;
mod stages;
#[cfg(test)]
mod testing;
#[cfg(test)]
mod tests;
mod turn;

use std::{
    sync::{Arc, Mutex},
    time::Duration,
};

use futures::{Stream, StreamExt as _};
use gleaner_learn::Policy as Model;
use tokio_util::sync::CancellationToken;
use tracing::Instrument as _;

use self::{
    engine::{Engine, Identity, lock},
    outlet::{Answers, Outlet},
    sequences::Sequences,
    session::{Session, Terms},
    shelf::Shelf,
};
use crate::{
    blobs::Blobs,
    config::ServeConfig,
    domain::{
        id::PolicyId,
        observation::{Acted, Observation, SessionInput},
        policy::{Deployment, Policy},
    },
    error::{Error, Kind, Result},
    store::Store,
};

/// Every loaded policy; clones share them.
#[derive(Clone)]
pub struct Policies(Arc<Inner>);

struct Inner {
    config: Arc<ServeConfig>,
    store: Store,
    blobs: Blobs,
    shelf: Mutex<Shelf<Model>>,
    sequences: Sequences<Model>,
    /// Held while a policy is loaded or a name is moved, so that a slow first use cannot undo a deployment.
    moving: tokio::sync::Mutex<()>,
}

impl Policies {
    /// Loads nothing yet.
    pub fn new(config: &Arc<ServeConfig>, store: Store, blobs: Blobs) -> Self {
        Self(Arc::new(Inner {
            config: Arc::clone(config),
            store,
            blobs,
            shelf: Mutex::new(Shelf::new(config.policies.policy_memory_bytes)),
            sequences: Sequences::default(),
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

    /// Points a name at a policy, once it is loaded and has answered. Running sessions keep theirs.
    ///
    /// # Errors
    /// NotFound; Precondition when the policy is not finished, its checkpoint cannot be read by this version, or the
    /// name belongs to another task.
    pub(crate) async fn deploy(&self, name: &str, policy: &PolicyId) -> Result<Deployment> {
        let policy = self.0.store.policy(policy).await?;
        let _moving = self.0.moving.lock().await;
        let engine = self.load(&policy).await?;
        let deployment = self.0.store.deploy(name, &policy.task_id, &policy.id).await?;
        lock(&self.0.shelf).point(name, &engine);
        tracing::info!(deployment.name = name, policy.id = %policy.id, "policy deployed");
        Ok(deployment)
    }

    /// Points a name back at the policy it pointed at before, once that is loaded and has answered.
    ///
    /// # Errors
    /// NotFound; Precondition when there is nothing before, or its checkpoint cannot be read by this version.
    pub(crate) async fn roll_back(&self, name: &str) -> Result<Deployment> {
        let _moving = self.0.moving.lock().await;
        let policy = self.0.store.policy(&self.0.store.before(name).await?).await?;
        let engine = self.load(&policy).await?;
        let deployment = self.0.store.roll_back(name).await?;
        lock(&self.0.shelf).point(name, &engine);
        tracing::info!(deployment.name = name, policy.id = %policy.id, "deployment rolled back");
        Ok(deployment)
    }

    /// One action from a window of observations that the caller keeps, oldest first.
    ///
    /// # Errors
    /// NotFound; Invalid naming the field; Exhausted when too many wait; Late when the deadline passes first.
    pub(crate) async fn act(&self, deployment: &str, observations: Vec<Observation>) -> Result<Acted> {
        let engine = self.deployed(deployment).await?;
        once::once(&engine, observations).await
    }

    /// Starts a session: the first input opens it. Answers come from the receiver; an error is the last.
    pub(crate) fn session(
        &self,
        inputs: impl Stream<Item = Result<SessionInput>> + Send + Unpin + 'static,
        stopping: CancellationToken,
    ) -> Answers {
        let (outlet, answers) = Outlet::new(self.0.config.policies.session_idle());
        let policies = self.clone();
        tokio::spawn(async move {
            let ended = policies.attend(inputs, &outlet, &stopping).await;
            // What only it held may go.
            lock(&policies.0.shelf).make_room(0);
            if let Err(error) = ended {
                outlet.fail(error);
            }
        });
        answers
    }

    async fn attend(
        &self,
        mut inputs: impl Stream<Item = Result<SessionInput>> + Send + Unpin,
        outlet: &Outlet,
        stopping: &CancellationToken,
    ) -> Result<()> {
        let idle = self.0.config.policies.session_idle();
        let first = tokio::select! {
            first = inputs.next() => first,
            () = tokio::time::sleep(idle) => return Err(Error::late("nothing came to open the session with; try again")),
            () = outlet.closed() => return Ok(()),
            () = stopping.cancelled() => return Err(Error::unavailable("the server is stopping; try again")),
        };
        let Some(SessionInput::Open { deployment, control_rate_hz, deadline }) = first.transpose()? else {
            return Err(Error::invalid("open", "must be the first message of a session"));
        };
        let engine = self.deployed(&deployment).await?;
        let terms = Terms {
            period: (control_rate_hz > 0.0)
                .then(|| Duration::try_from_secs_f64(1.0 / control_rate_hz).unwrap_or(Duration::MAX)),
            deadline,
            idle,
            drain: Duration::from_secs(self.0.config.drain_seconds),
        };
        let span = tracing::info_span!(
            "session", deployment.name = %deployment, policy.id = %engine.identity().policy_id, control.rate_hz = control_rate_hz
        );
        async {
            tracing::debug!("session opened");
            let ended = Session::new(engine, terms).run(inputs, outlet, stopping).await;
            match &ended {
                Ok(()) => tracing::debug!("session closed"),
                Err(error) if error.kind() == Kind::Cancelled => tracing::debug!(%error, "session broken off"),
                Err(error) => tracing::info!(%error, "session ended by an error"),
            }
            ended
        }
        .instrument(span)
        .await
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
        let deployment = self.0.store.deployment(name).await?;
        let id = deployment.policy_id().ok_or_else(|| Error::not_found("deployment", name))?;
        let engine = self.load(&self.0.store.policy(id).await?).await?;
        lock(&self.0.shelf).point(name, &engine);
        Ok(engine)
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
        };
        let (blobs, checkpoint) = (self.0.blobs.clone(), policy.checkpoint.clone());
        let engine =
            Engine::start(identity, move || Model::load(&blobs.get(&checkpoint)?).map_err(model::learned)).await?;
        lock(&self.0.shelf).put(&engine, bytes);
        Ok(engine)
    }
}
