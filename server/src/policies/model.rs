//! The interface of a model's thread to its model: policies of `learn`, or test doubles.

use gleaner_core::ensemble::Execution;
use gleaner_learn::{LearnError, Observed, Policy, PolicySession, TaskShape};

use super::remote_history::RemoteHistory;
pub(super) use crate::error::guarded;
use crate::error::{Error, Result};

/// One step of an observation, checked and decoded.
#[derive(Debug, Clone)]
pub(super) struct Step {
    /// Images in the model's layout.
    pub(super) frame: Vec<u8>,
    /// In physical units.
    pub(super) proprioception: Vec<f32>,
    /// The action executed since the previous step; `None` for the first step of a history.
    pub(super) executed: Option<Vec<f32>>,
}

/// What a new history begins with.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Begin {
    /// Seed, for a policy that draws its actions.
    pub(super) seed: u64,
    /// Whether each observation gets a new chunk, whatever the policy's own execution is.
    pub(super) new_chunks: bool,
}

impl Begin {
    /// How chunks are executed, of a policy that executes them by `own`.
    pub(super) fn execution(self, own: Execution) -> Execution {
        if self.new_chunks { Execution::Horizon(1) } else { own }
    }
}

/// The input of one request: steps to append to a history; the model acts on the last.
#[derive(Debug)]
pub(super) struct ModelInput<H> {
    /// `None` begins a new history.
    pub(super) history: Option<H>,
    /// For a new history.
    pub(super) begin: Begin,
    /// Control steps that passed unseen before the last of `steps`.
    pub(super) skipped: u64,
    /// Oldest first, at least one.
    pub(super) steps: Vec<Step>,
}

/// The model's output for one input.
#[derive(Debug)]
pub(super) struct Advanced<H> {
    /// The history with the input's steps.
    pub(super) history: H,
    /// Actions in physical units, one per control period.
    pub(super) actions: Vec<Vec<f32>>,
}

/// A policy as seen by its thread. Inputs are passed by reference, so that a failed batch can be run again one input at
/// a time.
pub(super) trait Model: 'static {
    /// The model's state per session.
    type History: Send + Sync + 'static;

    /// The shape of a step.
    fn shape(&self) -> &TaskShape;

    /// The steps in its window: l + 1.
    fn window(&self) -> usize;

    /// How its chunks are executed.
    fn execution(&self) -> Execution {
        Execution::default()
    }

    /// Whether an input needs the model's pass, and not only the rest of a chunk that was predicted before.
    fn predicts(&self, input: &ModelInput<Self::History>) -> bool {
        let _ = input;
        true
    }

    /// Answers every input of a batch, in order.
    fn advance(&self, inputs: &[&ModelInput<Self::History>]) -> Result<Vec<Advanced<Self::History>>>;
}

/// The state of a session with a policy of any origin.
#[derive(Debug, Clone)]
pub(super) enum History {
    /// With a policy that was trained here.
    Trained(PolicySession),
    /// With a policy that another server runs.
    Remote(RemoteHistory),
}

impl Model for Policy {
    type History = History;

    fn shape(&self) -> &TaskShape {
        self.shape()
    }

    fn window(&self) -> usize {
        usize::try_from(self.segment_length()).unwrap_or(usize::MAX).saturating_add(1)
    }

    fn execution(&self) -> Execution {
        self.execution()
    }

    fn predicts(&self, input: &ModelInput<History>) -> bool {
        let steps = input.skipped.saturating_add(input.steps.len() as u64);
        trained(input).is_none_or(|session| session.predicts_after(steps))
    }

    fn advance(&self, inputs: &[&ModelInput<History>]) -> Result<Vec<Advanced<History>>> {
        let mut sessions: Vec<PolicySession> = inputs.iter().map(|input| session(self, input)).collect();
        let steps: Vec<Vec<Observed<'_>>> =
            inputs.iter().map(|input| input.steps.iter().map(observed).collect()).collect();
        let mut advancing: Vec<_> =
            sessions.iter_mut().zip(&steps).map(|(one, steps)| (one, steps.as_slice())).collect();
        let actions = Policy::advance(self, &mut advancing).map_err(learned)?;
        let advanced = |(session, actions)| Advanced { history: History::Trained(session), actions };
        Ok(sessions.into_iter().zip(actions).map(advanced).collect())
    }
}

/// The session of an input. A session keeps its engine, so a model that was trained here sees no other history.
fn trained(input: &ModelInput<History>) -> Option<&PolicySession> {
    match &input.history {
        Some(History::Trained(session)) => Some(session),
        Some(History::Remote(_)) | None => None,
    }
}

/// The session of an input, with its skipped steps.
fn session(policy: &Policy, input: &ModelInput<History>) -> PolicySession {
    let new = || policy.session(input.begin.seed).executing(input.begin.execution(policy.execution()));
    let mut session = trained(input).cloned().unwrap_or_else(new);
    session.skip(input.skipped);
    session
}

fn observed(step: &Step) -> Observed<'_> {
    Observed { frame: &step.frame, proprioception: &step.proprioception, executed: step.executed.as_deref() }
}

/// Maps an error of `learn` to the caller's.
pub(super) fn learned(error: LearnError) -> Error {
    error.during("running a policy")
}

/// Runs a batch and checks the output: one entry per input, every value finite.
pub(super) fn answer<M: Model>(model: &M, inputs: &[&ModelInput<M::History>]) -> Result<Vec<Advanced<M::History>>> {
    let advanced = guarded("running a policy", || model.advance(inputs))?;
    if advanced.len() != inputs.len() {
        return Err(Error::internal("running a policy", "the number of outputs differs from the number of inputs"));
    }
    for input in &advanced {
        let right =
            |action: &Vec<f32>| action.len() == model.shape().action && action.iter().all(|value| value.is_finite());
        if input.actions.is_empty() || !input.actions.iter().all(right) {
            return Err(Error::internal("running a policy", "an action is not finite or has the wrong size"));
        }
    }
    Ok(advanced)
}
