//! The interface of a model's thread to its model: policies of `learn`, or test doubles.

use gleaner_learn::{Ensemble, History, LearnError, Policy, TaskShape};

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

/// The input of one request: steps to append to a history; the model acts on the last.
#[derive(Debug)]
pub(super) struct ModelInput<H> {
    /// `None` begins a new history.
    pub(super) history: Option<H>,
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

    /// Answers every input of a batch, in order.
    fn advance(&self, inputs: &[&ModelInput<Self::History>]) -> Result<Vec<Advanced<Self::History>>>;
}

/// A policy's state per session.
#[derive(Debug, Clone)]
pub(super) struct Memory {
    history: History,
    /// Predictions of earlier chunks; empty beyond the current step for policies that predict one action.
    ensemble: Ensemble,
    /// The control step of the newest observation.
    step: u64,
}

impl Model for Policy {
    type History = Memory;

    fn shape(&self) -> &TaskShape {
        self.shape()
    }

    fn window(&self) -> usize {
        usize::try_from(self.segment_length()).unwrap_or(usize::MAX).saturating_add(1)
    }

    fn advance(&self, inputs: &[&ModelInput<Memory>]) -> Result<Vec<Advanced<Memory>>> {
        let frames: Vec<&[u8]> =
            inputs.iter().flat_map(|input| &input.steps).map(|step| step.frame.as_slice()).collect();
        let mut embeddings = self.embed(&frames).map_err(learned)?.into_iter();
        let mut memories = Vec::with_capacity(inputs.len());
        for input in inputs {
            let mut memory = input.history.clone().unwrap_or_else(|| Memory {
                history: History::new(self.segment_length()),
                ensemble: self.ensemble(),
                step: 0,
            });
            memory.step += input.skipped;
            for step in &input.steps {
                if let Some(action) = &step.executed {
                    memory.history.set_executed(action.clone()).map_err(learned)?;
                }
                let embedding = embeddings
                    .next()
                    .ok_or_else(|| Error::internal("embedding frames", "fewer embeddings than frames"))?;
                memory.history.push(embedding, step.proprioception.clone()).map_err(learned)?;
                memory.step += 1;
            }
            memories.push(memory);
        }
        let chunks = self.act(&memories.iter().map(|memory| &memory.history).collect::<Vec<_>>()).map_err(learned)?;
        memories.into_iter().zip(chunks).map(|(memory, chunk)| ensembled(memory, chunk)).collect()
    }
}

/// The chunk, with its first action replaced by the ensemble of all chunks of the session that cover the current step.
fn ensembled(mut memory: Memory, mut actions: Vec<Vec<f32>>) -> Result<Advanced<Memory>> {
    let now = memory.ensemble.push(memory.step, actions.clone()).map_err(learned)?;
    if let Some(first) = actions.first_mut() {
        *first = now;
    }
    Ok(Advanced { history: memory, actions })
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
