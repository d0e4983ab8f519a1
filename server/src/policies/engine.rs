//! A loaded policy on its own thread, and the handle through which requests reach it.

use std::{
    sync::{Arc, Mutex},
    thread::JoinHandle,
    time::{Duration, Instant},
};

use gleaner_core::ensemble::Execution;
use gleaner_learn::TaskShape;
use tokio::sync::oneshot;

use super::{
    batch::{QueuedRequest, Server, StepResult},
    lock::lock,
    model::{Advanced, Begin, Model, ModelInput, answer},
    observation::blank,
    session_rates::{RateGuard, SessionRates},
    spin_wait::SpinWait,
    stages::Stages,
};
use crate::{
    domain::{
        id::{PolicyId, TaskId},
        policy::no_history,
    },
    error::{Error, Result},
};

/// The policy of an engine and the limits of its use.
#[derive(Debug, Clone)]
pub(super) struct Identity {
    pub(super) policy_id: PolicyId,
    /// Whether the policy acts without its history.
    pub(super) hide_history: bool,
    pub(super) task_id: TaskId,
    /// The most inputs in one batch.
    pub(super) batch: usize,
    /// The most inputs in the queue.
    pub(super) queue: usize,
    /// One control step of the policy's task.
    pub(super) period: Duration,
    /// The part of the fastest session's period, or of a control step if that is shorter, for which a free model may wait
    /// for other sessions.
    pub(super) wait: f64,
    /// The longest time for which the model's thread may spin for the next request.
    pub(super) spin: Duration,
}

impl Identity {
    /// What tells engines apart: the policy, and whether its history is hidden.
    pub(super) fn key(&self) -> (PolicyId, bool) {
        (self.policy_id.clone(), self.hide_history)
    }
}

/// An input to be answered.
pub(super) struct InferenceRequest<H> {
    pub(super) input: ModelInput<H>,
    /// Records when the request reached each stage.
    pub(super) stages: Arc<Stages>,
    /// After this, a reply is useless.
    pub(super) deadline: Option<Instant>,
}

/// Shape, window and execution of a loaded model, or the error of loading it.
type Ready = Result<(TaskShape, usize, Execution)>;

/// A handle to a model's thread. The thread ends when the last handle is dropped, or on `close`.
pub(super) struct Engine<M: Model> {
    identity: Identity,
    shape: Arc<TaskShape>,
    window: usize,
    execution: Execution,
    rates: Arc<SessionRates>,
    requests: Mutex<Option<flume::Sender<QueuedRequest<M::History>>>>,
    thread: Mutex<Option<JoinHandle<()>>>,
}

impl<M: Model> Engine<M> {
    /// Starts a thread, loads a model on it with `load`, and warms the model up with a blank observation.
    ///
    /// # Errors
    /// The error of `load` or of the warm-up.
    pub(super) async fn start(
        identity: Identity,
        load: impl FnOnce() -> Result<M> + Send + 'static,
    ) -> Result<Arc<Self>> {
        let (requests, waiting) = flume::bounded(identity.queue.max(1));
        let (ready_sender, ready) = oneshot::channel();
        let most = identity.batch.max(1);
        let (rates, spin_wait) = (SessionRates::new(identity.wait, identity.period), SpinWait::new(identity.spin));
        let shared_rates = Arc::clone(&rates);
        let thread = std::thread::Builder::new()
            .name(format!("policy {}", identity.policy_id))
            .spawn(move || {
                if let Some((model, took)) = warmed(load, ready_sender) {
                    Server { model, waiting, most, rates: shared_rates, spin_wait, took, last: 0 }.run();
                }
            })
            .map_err(|error| Error::internal("starting a policy's thread", error))?;
        let (shape, window, execution) = ready.await.map_err(|error| Error::internal("loading a policy", error))??;
        tracing::info!(policy.id = %identity.policy_id, "policy loaded");
        Ok(Arc::new(Self {
            identity,
            shape: Arc::new(shape),
            window,
            execution,
            rates,
            requests: Mutex::new(Some(requests)),
            thread: Mutex::new(Some(thread)),
        }))
    }

    /// A handle whose requests a task answers, in place of a thread. The task ends when its receiver is disconnected.
    pub(super) fn of_task(
        identity: Identity,
        (shape, window, execution): (TaskShape, usize, Execution),
    ) -> (Arc<Self>, flume::Receiver<QueuedRequest<M::History>>) {
        let (requests, waiting) = flume::bounded(identity.queue.max(1));
        let engine = Self {
            rates: SessionRates::new(identity.wait, identity.period),
            identity,
            shape: Arc::new(shape),
            window,
            execution,
            requests: Mutex::new(Some(requests)),
            thread: Mutex::new(None),
        };
        (Arc::new(engine), waiting)
    }

    pub(super) fn identity(&self) -> &Identity {
        &self.identity
    }

    pub(super) fn shape(&self) -> Arc<TaskShape> {
        Arc::clone(&self.shape)
    }

    /// Rejects a history that is to be hidden and that the model does not have. Loading does not: earlier versions stored such
    /// deployments.
    ///
    /// # Errors
    /// Invalid.
    pub(super) fn expect_history(&self) -> Result<()> {
        if !self.identity.hide_history || self.window > 1 {
            return Ok(());
        }
        Err(no_history("hide_history", &self.identity.policy_id))
    }

    /// The steps in the model's window: l + 1.
    pub(super) fn window(&self) -> usize {
        self.window
    }

    /// How the model's chunks are executed.
    pub(super) fn execution(&self) -> Execution {
        self.execution
    }

    /// Registers a session that sends one request per period; `None`: per control period of the task.
    pub(super) fn join(&self, period: Option<Duration>) -> RateGuard {
        self.rates.join(period.unwrap_or(self.identity.period))
    }

    /// Sends an input and waits for the result; refused at once when the queue is full. For callers with any number of
    /// requests in flight.
    pub(super) async fn try_infer_by(&self, call: InferenceRequest<M::History>) -> Result<StepResult<M::History>> {
        let (request, answer) = call.request();
        self.requests()?.try_send(request).map_err(|error| match error {
            flume::TrySendError::Full(_) => Error::exhausted(format!(
                "the queue of policy {} is full ({} observations); retry later",
                self.identity.policy_id, self.identity.queue
            )),
            flume::TrySendError::Disconnected(_) => stopped(),
        })?;
        answer.await.map_err(|_| stopped())?
    }

    /// Sends an input and waits for the result and, before, for a place in the queue. For sessions, which have one
    /// request in flight.
    pub(super) async fn infer_by(&self, call: InferenceRequest<M::History>) -> Result<StepResult<M::History>> {
        let (request, answer) = call.request();
        self.requests()?.into_send_async(request).await.map_err(|_| stopped())?;
        answer.await.map_err(|_| stopped())?
    }

    /// As [`Self::try_infer_by`], without a deadline.
    pub(super) async fn try_infer(&self, input: ModelInput<M::History>) -> Result<Advanced<M::History>> {
        self.try_infer_by(InferenceRequest::new(input)).await?.advanced()
    }

    /// As [`Self::infer_by`], without a deadline.
    pub(super) async fn infer(&self, input: ModelInput<M::History>) -> Result<Advanced<M::History>> {
        self.infer_by(InferenceRequest::new(input)).await?.advanced()
    }

    /// Accepts no more requests; blocks until the queue is answered and the thread has ended.
    pub(super) fn close(&self) {
        drop(lock(&self.requests).take());
        let thread = lock(&self.thread).take();
        if let Some(thread) = thread
            && thread.join().is_err()
        {
            tracing::error!(policy.id = %self.identity.policy_id, "the policy's thread panicked");
        }
    }

    fn requests(&self) -> Result<flume::Sender<QueuedRequest<M::History>>> {
        lock(&self.requests).clone().ok_or_else(stopped)
    }
}

impl<H> InferenceRequest<H> {
    /// A request without a deadline whose timings are not read.
    fn new(input: ModelInput<H>) -> Self {
        Self { input, stages: Arc::new(Stages::begin()), deadline: None }
    }

    fn request(self) -> (QueuedRequest<H>, oneshot::Receiver<Result<StepResult<H>>>) {
        let Self { input, stages, deadline } = self;
        let (reply, answer) = oneshot::channel();
        (QueuedRequest { input, stages, deadline, since: Instant::now(), reply }, answer)
    }
}

fn stopped() -> Error {
    Error::unavailable("the policy is being unloaded or the server is stopping; retry")
}

/// The start of a model's thread: loads and warms up the model and sends its shape. Returns the model and the duration
/// of the warm-up; `None` when that failed or the caller is gone.
fn warmed<M: Model>(load: impl FnOnce() -> Result<M>, ready_sender: oneshot::Sender<Ready>) -> Option<(M, Duration)> {
    // One thread per model: several would compete for the processors and delay every reply.
    gleaner_learn::set_threads(1);
    let loaded = super::model::guarded("loading a policy", || {
        let model = load()?;
        let begun = Instant::now();
        answer(
            &model,
            &[&ModelInput { history: None, begin: Begin::default(), skipped: 0, steps: vec![blank(model.shape())] }],
        )?;
        Ok((model, begun.elapsed()))
    });
    match loaded {
        Ok((model, took)) => {
            let loaded = (model.shape().clone(), model.window(), model.execution());
            ready_sender.send(Ok(loaded)).is_ok().then_some((model, took))
        }
        Err(error) => {
            // The caller may be gone.
            let _ = ready_sender.send(Err(error));
            None
        }
    }
}

#[cfg(test)]
mod tests;
