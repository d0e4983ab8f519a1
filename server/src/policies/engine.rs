//! One loaded policy on a thread of its own: answers what is waiting as one batch, and never waits to fill one.

use std::{
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    thread::JoinHandle,
    time::{Duration, Instant},
};

use gleaner_learn::TaskShape;
use tokio::sync::{mpsc, oneshot};

use super::{
    model::{Advanced, Model, Turn, answer},
    observation::blank,
};
use crate::{
    domain::id::{PolicyId, TaskId},
    error::{Error, Result},
};

/// Which policy an engine runs, and how it may be used.
#[derive(Debug, Clone)]
pub(super) struct Identity {
    pub(super) policy_id: PolicyId,
    pub(super) task_id: TaskId,
    /// Most turns in one batch.
    pub(super) batch: usize,
    /// Most turns that may wait.
    pub(super) queue: usize,
}

/// What a turn cost and gave.
#[derive(Debug)]
pub(super) struct Answer<H> {
    pub(super) advanced: Advanced<H>,
    pub(super) queued: Duration,
    pub(super) model: Duration,
}

struct Request<H> {
    turn: Turn<H>,
    since: Instant,
    reply: oneshot::Sender<Result<Answer<H>>>,
}

/// What a model says of itself once it is loaded.
type Ready = Result<(TaskShape, usize)>;

/// A handle to a model's thread. The thread ends when the last handle is gone, or on `close`.
pub(super) struct Engine<M: Model> {
    identity: Identity,
    shape: Arc<TaskShape>,
    window: usize,
    requests: Mutex<Option<mpsc::Sender<Request<M::History>>>>,
    thread: Mutex<Option<JoinHandle<()>>>,
}

impl<M: Model> Engine<M> {
    /// Starts a thread, loads a model on it with `load`, and has it answer a blank observation.
    ///
    /// # Errors
    /// What `load` or the warm-up says.
    pub(super) async fn start(
        identity: Identity,
        load: impl FnOnce() -> Result<M> + Send + 'static,
    ) -> Result<Arc<Self>> {
        let (requests, waiting) = mpsc::channel(identity.queue.max(1));
        let (tell, told) = oneshot::channel();
        let batch = identity.batch.max(1);
        let thread = std::thread::Builder::new()
            .name(format!("policy {}", identity.policy_id))
            .spawn(move || run(load, tell, waiting, batch))
            .map_err(|error| Error::internal("starting a policy's thread", error))?;
        let (shape, window) = told.await.map_err(|error| Error::internal("loading a policy", error))??;
        tracing::info!(policy.id = %identity.policy_id, "policy loaded");
        Ok(Arc::new(Self {
            identity,
            shape: Arc::new(shape),
            window,
            requests: Mutex::new(Some(requests)),
            thread: Mutex::new(Some(thread)),
        }))
    }

    pub(super) fn identity(&self) -> &Identity {
        &self.identity
    }

    pub(super) fn shape(&self) -> Arc<TaskShape> {
        Arc::clone(&self.shape)
    }

    /// Steps the model looks at: l + 1.
    pub(super) fn window(&self) -> usize {
        self.window
    }

    /// Has a turn answered, or refuses at once when too many wait: for callers that may ask any number of times.
    pub(super) async fn try_ask(&self, turn: Turn<M::History>) -> Result<Answer<M::History>> {
        let (request, answer) = request(turn);
        self.requests()?.try_send(request).map_err(|error| match error {
            mpsc::error::TrySendError::Full(_) => Error::exhausted(format!(
                "{} observations wait for policy {} already; try again later",
                self.identity.queue, self.identity.policy_id
            )),
            mpsc::error::TrySendError::Closed(_) => stopped(),
        })?;
        answer.await.map_err(|_| stopped())?
    }

    /// Has a turn answered, waiting for a place in the queue: for sessions, which ask once at a time.
    pub(super) async fn ask(&self, turn: Turn<M::History>) -> Result<Answer<M::History>> {
        let (request, answer) = request(turn);
        self.requests()?.send(request).await.map_err(|_| stopped())?;
        answer.await.map_err(|_| stopped())?
    }

    /// Takes no more turns and waits, blocking, until what waits is answered and the thread has ended.
    pub(super) fn close(&self) {
        drop(lock(&self.requests).take());
        let thread = lock(&self.thread).take();
        if let Some(thread) = thread
            && thread.join().is_err()
        {
            tracing::error!(policy.id = %self.identity.policy_id, "the policy's thread had panicked");
        }
    }

    fn requests(&self) -> Result<mpsc::Sender<Request<M::History>>> {
        lock(&self.requests).clone().ok_or_else(stopped)
    }
}

fn request<H>(turn: Turn<H>) -> (Request<H>, oneshot::Receiver<Result<Answer<H>>>) {
    let (reply, answer) = oneshot::channel();
    (Request { turn, since: Instant::now(), reply }, answer)
}

fn stopped() -> Error {
    Error::unavailable("the policy is being unloaded or the server is stopping; try again")
}

/// Locks; a panic while it was held leaves these values whole.
pub(super) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The thread: load, warm up, say so, then serve until nobody can ask any more.
fn run<M: Model>(
    load: impl FnOnce() -> Result<M>,
    tell: oneshot::Sender<Ready>,
    mut waiting: mpsc::Receiver<Request<M::History>>,
    most: usize,
) {
    // One thread a model: several would fight over the processors and make every answer late.
    gleaner_learn::set_threads(1);
    let loaded = super::model::guarded("loading a policy", || {
        let model = load()?;
        answer(&model, &[&Turn { history: None, skipped: 0, steps: vec![blank(model.shape())] }])?;
        Ok(model)
    });
    let model = match loaded {
        Ok(model) => model,
        Err(error) => {
            // Nobody listens when the caller has gone.
            let _ = tell.send(Err(error));
            return;
        }
    };
    if tell.send(Ok((model.shape().clone(), model.window()))).is_err() {
        return;
    }
    while let Some(first) = waiting.blocking_recv() {
        let mut batch = vec![first];
        while batch.len() < most {
            match waiting.try_recv() {
                Ok(next) => batch.push(next),
                Err(_) => break,
            }
        }
        batch.retain(|request| !request.reply.is_closed());
        serve(&model, batch);
    }
}

/// Answers a batch. If it fails as a whole, each turn is tried alone, so that only the one at fault fails.
fn serve<M: Model>(model: &M, mut batch: Vec<Request<M::History>>) {
    let begun = Instant::now();
    let turns: Vec<_> = batch.iter().map(|request| &request.turn).collect();
    let answered = if turns.is_empty() { Ok(Vec::new()) } else { answer(model, &turns) };
    // Below, a caller that has gone meanwhile needs no answer.
    match answered {
        Ok(advanced) => {
            let model = begun.elapsed();
            for (request, advanced) in batch.into_iter().zip(advanced) {
                let queued = begun.saturating_duration_since(request.since);
                let _ = request.reply.send(Ok(Answer { advanced, queued, model }));
            }
        }
        Err(error) if batch.len() > 1 => {
            tracing::warn!(%error, batch.turns = batch.len(), "a batch failed; answering its turns one by one");
            for request in batch {
                serve(model, vec![request]);
            }
        }
        Err(error) => {
            if let Some(alone) = batch.pop() {
                let _ = alone.reply.send(Err(error));
            }
        }
    }
}

#[cfg(test)]
mod tests;
