//! One loaded policy on a thread of its own, and how others ask it.

use std::{
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    thread::JoinHandle,
    time::{Duration, Instant},
};

use gleaner_learn::TaskShape;
use tokio::sync::oneshot;

use super::{
    batch::{Request, Server, Turned},
    model::{Advanced, Model, Turn, answer},
    observation::blank,
    pace::{Pace, Seat},
    stages::Stages,
    vigil::Vigil,
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
    /// One control step of its task.
    pub(super) period: Duration,
    /// The part of the fastest session's period that a free model may wait for others.
    pub(super) wait: f64,
    /// The longest wait for a request that its thread may be awake for.
    pub(super) awake: Duration,
}

/// A turn to be answered.
pub(super) struct Ask<H> {
    pub(super) turn: Turn<H>,
    /// Where it writes down how far it came.
    pub(super) stages: Arc<Stages>,
    /// When an answer is of no use any more.
    pub(super) deadline: Option<Instant>,
}

/// What a model says of itself once it is loaded.
type Ready = Result<(TaskShape, usize)>;

/// A handle to a model's thread. The thread ends when the last handle is gone, or on `close`.
pub(super) struct Engine<M: Model> {
    identity: Identity,
    shape: Arc<TaskShape>,
    window: usize,
    pace: Arc<Pace>,
    requests: Mutex<Option<flume::Sender<Request<M::History>>>>,
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
        let (requests, waiting) = flume::bounded(identity.queue.max(1));
        let (tell, told) = oneshot::channel();
        let most = identity.batch.max(1);
        let (pace, vigil) = (Pace::new(identity.wait), Vigil::new(identity.awake));
        let paced = Arc::clone(&pace);
        let thread = std::thread::Builder::new()
            .name(format!("policy {}", identity.policy_id))
            .spawn(move || {
                if let Some((model, took)) = warmed(load, tell) {
                    Server { model, waiting, most, pace: paced, vigil, took, last: 0 }.run();
                }
            })
            .map_err(|error| Error::internal("starting a policy's thread", error))?;
        let (shape, window) = told.await.map_err(|error| Error::internal("loading a policy", error))??;
        tracing::info!(policy.id = %identity.policy_id, "policy loaded");
        Ok(Arc::new(Self {
            identity,
            shape: Arc::new(shape),
            window,
            pace,
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

    /// A session opens that will ask once a period; `None`: once a control period of the task.
    pub(super) fn join(&self, period: Option<Duration>) -> Seat {
        self.pace.join(period.unwrap_or(self.identity.period))
    }

    /// Has a turn answered by its deadline, or refuses at once when too many wait: for callers that may ask any
    /// number of times.
    pub(super) async fn try_ask_by(&self, ask: Ask<M::History>) -> Result<Turned<M::History>> {
        let (request, answer) = ask.request();
        self.requests()?.try_send(request).map_err(|error| match error {
            flume::TrySendError::Full(_) => Error::exhausted(format!(
                "{} observations wait for policy {} already; try again later",
                self.identity.queue, self.identity.policy_id
            )),
            flume::TrySendError::Disconnected(_) => stopped(),
        })?;
        answer.await.map_err(|_| stopped())?
    }

    /// Has a turn answered by its deadline, waiting for a place in the queue: for sessions, which ask once at a time.
    pub(super) async fn ask_by(&self, ask: Ask<M::History>) -> Result<Turned<M::History>> {
        let (request, answer) = ask.request();
        self.requests()?.into_send_async(request).await.map_err(|_| stopped())?;
        answer.await.map_err(|_| stopped())?
    }

    /// As [`Self::try_ask_by`], however long it takes.
    pub(super) async fn try_ask(&self, turn: Turn<M::History>) -> Result<Advanced<M::History>> {
        self.try_ask_by(Ask::new(turn)).await?.advanced()
    }

    /// As [`Self::ask_by`], however long it takes.
    pub(super) async fn ask(&self, turn: Turn<M::History>) -> Result<Advanced<M::History>> {
        self.ask_by(Ask::new(turn)).await?.advanced()
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

    fn requests(&self) -> Result<flume::Sender<Request<M::History>>> {
        lock(&self.requests).clone().ok_or_else(stopped)
    }
}

impl<H> Ask<H> {
    /// Without a deadline; nobody will ask for its timings.
    fn new(turn: Turn<H>) -> Self {
        Self { turn, stages: Arc::new(Stages::begin()), deadline: None }
    }

    fn request(self) -> (Request<H>, oneshot::Receiver<Result<Turned<H>>>) {
        let Self { turn, stages, deadline } = self;
        let (reply, answer) = oneshot::channel();
        (Request { turn, stages, deadline, since: Instant::now(), reply }, answer)
    }
}

fn stopped() -> Error {
    Error::unavailable("the policy is being unloaded or the server is stopping; try again")
}

/// Locks; a panic while it was held leaves these values whole.
pub(super) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The beginning of a model's thread: loads, warms up and says so. `None` when that failed or nobody listens. Gives the
/// model and how long the warm-up took.
fn warmed<M: Model>(load: impl FnOnce() -> Result<M>, tell: oneshot::Sender<Ready>) -> Option<(M, Duration)> {
    // One thread a model: several would fight over the processors and make every answer late.
    gleaner_learn::set_threads(1);
    let loaded = super::model::guarded("loading a policy", || {
        let model = load()?;
        let begun = Instant::now();
        answer(&model, &[&Turn { history: None, skipped: 0, steps: vec![blank(model.shape())] }])?;
        Ok((model, begun.elapsed()))
    });
    match loaded {
        Ok((model, took)) => {
            let ready = (model.shape().clone(), model.window());
            tell.send(Ok(ready)).is_ok().then_some((model, took))
        }
        Err(error) => {
            // Nobody listens when the caller has gone.
            let _ = tell.send(Err(error));
            None
        }
    }
}

#[cfg(test)]
mod tests;
