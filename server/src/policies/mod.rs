//! Serving policies: which are loaded, under which names, and the sessions that use them.
//!
//! A policy is loaded when it is deployed or first asked for, and kept while a deployment points at it or a session
//! holds it. Knows no wire type and no SQL.

mod engine;
mod model;
mod observation;
mod session;
#[cfg(test)]
mod testing;
#[cfg(test)]
mod tests;

use std::{
    collections::HashMap,
    sync::{Arc, Mutex, Weak},
};

use futures::{Stream, StreamExt as _};
use gleaner_learn::Policy as Model;
use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;
use tracing::Instrument as _;

use self::{
    engine::{Engine, Identity, lock},
    session::{Outputs, Session},
};
use crate::{
    blobs::Blobs,
    config::ServeConfig,
    domain::{
        id::PolicyId,
        observation::{Acted, Observation, SessionInput, SessionOutput},
        policy::{Deployment, Policy},
    },
    error::{Error, Kind, Result},
    store::Store,
};

/// Answers of one session that may wait for its robot to read them.
const UNREAD: usize = 16;

/// Every loaded policy; clones share them.
#[derive(Clone)]
pub struct Policies(Arc<Inner>);

struct Inner {
    batch: usize,
    queue: usize,
    store: Store,
    blobs: Blobs,
    shelf: Mutex<Shelf>,
    /// Held while a policy is loaded or a name is moved, so that a slow first use cannot undo a deployment.
    moving: tokio::sync::Mutex<()>,
}

/// What is loaded. Names hold their policy; a policy without a name lives on while sessions hold it.
#[derive(Default)]
struct Shelf {
    deployed: HashMap<String, Arc<Engine<Model>>>,
    loaded: HashMap<PolicyId, Weak<Engine<Model>>>,
    stopped: bool,
}

impl Policies {
    /// Loads nothing yet.
    pub fn new(config: &Arc<ServeConfig>, store: Store, blobs: Blobs) -> Self {
        Self(Arc::new(Inner {
            batch: config.policies.policy_batch,
            queue: config.policies.policy_queue,
            store,
            blobs,
            shelf: Mutex::default(),
            moving: tokio::sync::Mutex::default(),
        }))
    }

    /// Unloads every policy: what waits is answered, what comes later is refused.
    pub async fn stop(&self) {
        let _moving = self.0.moving.lock().await;
        let engines: Vec<_> = {
            let mut shelf = lock(&self.0.shelf);
            shelf.stopped = true;
            shelf.deployed.clear();
            shelf.loaded.drain().filter_map(|(_, engine)| engine.upgrade()).collect()
        };
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
        lock(&self.0.shelf).deployed.insert(name.to_owned(), engine);
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
        lock(&self.0.shelf).deployed.insert(name.to_owned(), engine);
        tracing::info!(deployment.name = name, policy.id = %policy.id, "deployment rolled back");
        Ok(deployment)
    }

    /// One action from a window of observations that the caller keeps, oldest first.
    ///
    /// # Errors
    /// NotFound; Invalid naming the field; Exhausted when too many wait.
    pub(crate) async fn act(&self, deployment: &str, observations: Vec<Observation>) -> Result<Acted> {
        let engine = self.deployed(deployment).await?;
        session::once(&engine, observations).await
    }

    /// Starts a session: the first input opens it. Answers come from the receiver; an error is the last.
    pub(crate) fn session(
        &self,
        inputs: impl Stream<Item = Result<SessionInput>> + Send + Unpin + 'static,
        stopping: CancellationToken,
    ) -> mpsc::Receiver<Result<SessionOutput>> {
        let (outputs, answers) = mpsc::channel(UNREAD);
        let policies = self.clone();
        tokio::spawn(async move {
            if let Err(error) = policies.attend(inputs, &outputs, &stopping).await {
                // A robot that has gone reads no error.
                let _ = outputs.send(Err(error)).await;
            }
        });
        answers
    }

    async fn attend(
        &self,
        mut inputs: impl Stream<Item = Result<SessionInput>> + Send + Unpin,
        outputs: &Outputs,
        stopping: &CancellationToken,
    ) -> Result<()> {
        let first = tokio::select! {
            first = inputs.next() => first,
            () = outputs.closed() => return Ok(()),
            () = stopping.cancelled() => return Err(Error::unavailable("the server is stopping; try again")),
        };
        let Some(SessionInput::Open { deployment, control_rate_hz, deadline: _ }) = first.transpose()? else {
            return Err(Error::invalid("open", "must be the first message of a session"));
        };
        let engine = self.deployed(&deployment).await?;
        let span = tracing::info_span!(
            "session", deployment.name = %deployment, policy.id = %engine.identity().policy_id, control.rate_hz = control_rate_hz
        );
        async {
            tracing::debug!("session opened");
            let ended = Session::new(engine).run(inputs, outputs, stopping).await;
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
        let find = || lock(&self.0.shelf).deployed.get(name).cloned();
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
        lock(&self.0.shelf).deployed.insert(name.to_owned(), Arc::clone(&engine));
        Ok(engine)
    }

    /// The policy's engine: the one that is loaded, or a new one. Only with `moving` held.
    async fn load(&self, policy: &Policy) -> Result<Arc<Engine<Model>>> {
        {
            let shelf = lock(&self.0.shelf);
            if shelf.stopped {
                return Err(Error::unavailable("the server is stopping; try again"));
            }
            if let Some(engine) = shelf.loaded.get(&policy.id).and_then(Weak::upgrade) {
                return Ok(engine);
            }
        }
        let identity = Identity {
            policy_id: policy.id.clone(),
            task_id: policy.task_id.clone(),
            batch: self.0.batch,
            queue: self.0.queue,
        };
        let (blobs, checkpoint) = (self.0.blobs.clone(), policy.checkpoint.clone());
        let engine =
            Engine::start(identity, move || Model::load(&blobs.get(&checkpoint)?).map_err(model::learned)).await?;
        let mut shelf = lock(&self.0.shelf);
        shelf.loaded.retain(|_, engine| engine.strong_count() > 0);
        shelf.loaded.insert(policy.id.clone(), Arc::downgrade(&engine));
        Ok(engine)
    }
}
