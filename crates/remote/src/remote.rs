//! A registered policy with its server, and the sessions with it.

use std::{
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::Duration,
};

use gleaner_core::{
    Error, Result, TaskSpec,
    error::Kind,
    remote::{Protocol, RemotePolicy},
};
use tokio::time::timeout;

use crate::{
    actions::Actions,
    address::Address,
    backoff::Backoff,
    fault::At,
    inputs::{Inputs, Step},
    open_inference::{Connection, Sequence},
    openpi::Socket,
    outgoing::Outgoing,
};

/// How long a server may take to accept a connection and to describe itself.
const CONNECT: Duration = Duration::from_secs(5);
/// How long it may take to answer the first observation of all, for which models are compiled.
const WARM_UP: Duration = Duration::from_secs(60);

/// A policy on another server; its sessions share it.
#[derive(Debug)]
pub struct Remote {
    policy: RemotePolicy,
    address: Address,
    inputs: Inputs,
    actions: Actions,
    outgoing: Outgoing,
    backoff: Backoff,
    /// The connection of the Open Inference Protocol, which its sessions share.
    connection: Mutex<Option<Connection>>,
    /// Held while it is opened.
    opening: tokio::sync::Mutex<()>,
}

/// One call of a policy.
#[derive(Debug, Clone, Copy)]
struct Call {
    /// How long the server may take to answer.
    limit: Duration,
    /// Whether an operator waits for it: it is made even if no attempt is due, and ends its session.
    first_of_all: bool,
}

/// One session with a policy. Its state on the other server ends with it, with a failed call, or with a connection of
/// openpi's protocol: the next call begins again.
#[derive(Debug)]
pub struct Episode {
    remote: Arc<Remote>,
    state: State,
}

#[derive(Debug)]
enum State {
    /// Each observation stands alone.
    Single,
    /// `None` before the first observation.
    Sequence(Option<i64>),
    /// `None` while there is no connection.
    Openpi(Option<Box<Socket>>),
}

impl Remote {
    /// A policy of a task, under the operator's rules. Does not connect.
    ///
    /// # Errors
    /// Invalid for an address that does not fit the protocol; Precondition when its host may not be called.
    pub fn new(policy: RemotePolicy, task: &TaskSpec, outgoing: Outgoing) -> Result<Self> {
        let address = Address::parse(policy.protocol, &policy.address)?;
        outgoing.permit(&address)?;
        let (inputs, actions) = (Inputs::of(&policy, task)?, Actions::of(&policy, task));
        let (backoff, connection, opening) = (Backoff::default(), Mutex::default(), tokio::sync::Mutex::default());
        Ok(Self { policy, address, inputs, actions, outgoing, backoff, connection, opening })
    }

    /// Connects, and has the policy answer a blank observation.
    ///
    /// # Errors
    /// Unavailable when the server does not answer; Precondition when it answers with something else than actions.
    pub async fn check(self: &Arc<Self>) -> Result<()> {
        let (frame, proprioception) = self.inputs.blank();
        let step = Step { frame: &frame, proprioception: &proprioception, executed: None };
        let mut episode = self.episode();
        let result = episode.attempt(&step, Call { limit: WARM_UP, first_of_all: true }).await;
        self.note(&result);
        result.map(|_| ())
    }

    /// A new session.
    #[must_use]
    pub fn episode(self: &Arc<Self>) -> Episode {
        Episode { remote: Arc::clone(self), state: self.state() }
    }

    fn state(&self) -> State {
        match self.policy.protocol {
            Protocol::OpenInference if self.policy.sequences => State::Sequence(None),
            Protocol::OpenInference => State::Single,
            Protocol::Openpi => State::Openpi(None),
        }
    }

    /// Notes whether the server answered; a broken connection is not used again.
    fn note<T>(&self, result: &Result<T>) {
        self.backoff.note(&self.address.text, result);
        if result.as_ref().is_err_and(|error| error.kind() == Kind::Unavailable) {
            *self.open_connection() = None;
        }
    }

    fn open_connection(&self) -> MutexGuard<'_, Option<Connection>> {
        self.connection.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The connection of the Open Inference Protocol; opens it if needed.
    async fn connection(&self, call: Call) -> Result<Connection> {
        if let Some(open) = self.open_connection().clone() {
            return Ok(open);
        }
        let _opening = self.opening.lock().await;
        if let Some(open) = self.open_connection().clone() {
            return Ok(open);
        }
        if !call.first_of_all {
            // Another session may have failed to open it meanwhile.
            self.backoff.admit()?;
        }
        let (frame, proprioception) = self.inputs.blank();
        let blank = Step { frame: &frame, proprioception: &proprioception, executed: None };
        let values = self.inputs.values(&blank)?;
        let opening = Connection::open(&self.policy, &self.address, &self.outgoing, (&values, &self.actions));
        let opened = self.within(CONNECT, opening).await;
        self.note(&opened);
        let open = opened?;
        *self.open_connection() = Some(open.clone());
        Ok(open)
    }

    /// Ends a call that takes too long.
    async fn within<T>(&self, limit: Duration, call: impl Future<Output = Result<T>>) -> Result<T> {
        timeout(limit, call).await.unwrap_or_else(|_| Err(self.late(limit)))
    }

    fn late(&self, limit: Duration) -> Error {
        At(self.address.text.clone()).silent(format!("no answer within {} ms", limit.as_millis()))
    }
}

impl Episode {
    /// The actions for the newest step, at most the policy's chunk, in physical units and finite.
    ///
    /// # Errors
    /// Unavailable when the server does not answer, at once while no attempt is due; Precondition when it refuses the
    /// observation or answers with something else than actions.
    pub async fn infer(&mut self, step: &Step<'_>) -> Result<Vec<Vec<f32>>> {
        self.remote.backoff.admit()?;
        let limit = Duration::from_millis(self.remote.policy.answer_within_ms.into());
        let result = self.attempt(step, Call { limit, first_of_all: false }).await;
        self.remote.note(&result);
        result
    }

    /// One call. The state is taken out for its time, so that a call that fails or is dropped begins the next one again.
    async fn attempt(&mut self, step: &Step<'_>, call: Call) -> Result<Vec<Vec<f32>>> {
        let remote = Arc::clone(&self.remote);
        let values = remote.inputs.values(step)?;
        let before = std::mem::replace(&mut self.state, remote.state());
        match before {
            State::Single => {
                let connection = remote.connection(call).await?;
                let answer = connection.infer(&remote.policy, values, None, &remote.actions);
                remote.within(call.limit, answer).await
            }
            State::Sequence(begun) => {
                let connection = remote.connection(call).await?;
                let id = begun.unwrap_or_else(|| rand::random_range(1..=i64::MAX));
                let sequence = Sequence { id, start: begun.is_none(), end: call.first_of_all };
                let answer = connection.infer(&remote.policy, values, Some(sequence), &remote.actions);
                let actions = remote.within(call.limit, answer).await?;
                self.state = State::Sequence(Some(id));
                Ok(actions)
            }
            State::Openpi(socket) => {
                // A connection that was lost between observations is replaced, and costs no step.
                let mut socket = match socket.filter(|socket| !socket.is_lost()) {
                    Some(socket) => socket,
                    None => {
                        let opening = Socket::open(&remote.address, &remote.outgoing, &remote.actions);
                        Box::new(remote.within(CONNECT, opening).await?)
                    }
                };
                let actions = remote.within(call.limit, socket.infer(&values, &remote.actions)).await?;
                self.state = State::Openpi(Some(socket));
                Ok(actions)
            }
        }
    }
}
