//! What a model thread runs, behind a small seam: `learn`'s policies, or in tests anything.

use gleaner_learn::{Ensemble, History, LearnError, Policy, TaskShape};

pub(super) use crate::error::guarded;
use crate::error::{Error, Result};

/// One step of an observation, checked and decoded.
#[derive(Debug, Clone)]
pub(super) struct Step {
    /// Images as the model takes them.
    pub(super) frame: Vec<u8>,
    /// In physical units.
    pub(super) proprioception: Vec<f32>,
    /// The action executed since the step before; `None` for a history's first step.
    pub(super) executed: Option<Vec<f32>>,
}

/// What is asked of a model: to remember these steps on top of a history and to act on the last.
#[derive(Debug)]
pub(super) struct Turn<H> {
    /// `None` begins a new one.
    pub(super) history: Option<H>,
    /// Control steps that passed unseen before the last of `steps`.
    pub(super) skipped: u64,
    /// Oldest first, at least one.
    pub(super) steps: Vec<Step>,
}

/// What came of a turn.
#[derive(Debug)]
pub(super) struct Advanced<H> {
    /// The history with the turn's steps.
    pub(super) history: H,
    /// Actions in physical units, one a control period.
    pub(super) actions: Vec<Vec<f32>>,
}

/// A policy as its thread sees it. Turns go in by reference, so that a failed batch can be run again turn by turn.
pub(super) trait Model: 'static {
    /// What it remembers of a session.
    type History: Send + Sync + 'static;

    /// What a step must hold.
    fn shape(&self) -> &TaskShape;

    /// Steps it looks at: l + 1.
    fn window(&self) -> usize;

    /// Answers every turn of a batch, in order.
    fn advance(&self, turns: &[&Turn<Self::History>]) -> Result<Vec<Advanced<Self::History>>>;
}

/// What a policy remembers of a session.
#[derive(Debug, Clone)]
pub(super) struct Memory {
    history: History,
    /// What earlier chunks foresaw; nothing beyond now for policies that give one action.
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

    fn advance(&self, turns: &[&Turn<Memory>]) -> Result<Vec<Advanced<Memory>>> {
        let frames: Vec<&[u8]> = turns.iter().flat_map(|turn| &turn.steps).map(|step| step.frame.as_slice()).collect();
        let mut embeddings = self.embed(&frames).map_err(learned)?.into_iter();
        let mut memories = Vec::with_capacity(turns.len());
        for turn in turns {
            let mut memory = turn.history.clone().unwrap_or_else(|| Memory {
                history: History::new(self.segment_length()),
                ensemble: Ensemble::new(),
                step: 0,
            });
            memory.step += turn.skipped;
            for step in &turn.steps {
                if let Some(action) = &step.executed {
                    memory.history.set_executed(action.clone()).map_err(learned)?;
                }
                let embedding = embeddings
                    .next()
                    .ok_or_else(|| Error::internal("embedding frames", "fewer embeddings came than frames went"))?;
                memory.history.push(embedding, step.proprioception.clone()).map_err(learned)?;
                memory.step += 1;
            }
            memories.push(memory);
        }
        let chunks = self.act(&memories.iter().map(|memory| &memory.history).collect::<Vec<_>>()).map_err(learned)?;
        memories.into_iter().zip(chunks).map(|(memory, chunk)| ensembled(memory, chunk)).collect()
    }
}

/// The chunk, but the action for now is what all chunks of the session that reach it say together.
fn ensembled(mut memory: Memory, mut actions: Vec<Vec<f32>>) -> Result<Advanced<Memory>> {
    let now = memory.ensemble.push(memory.step, actions.clone()).map_err(learned)?;
    if let Some(first) = actions.first_mut() {
        *first = now;
    }
    Ok(Advanced { history: memory, actions })
}

/// What an error of `learn` means to who asked for a policy.
pub(super) fn learned(error: LearnError) -> Error {
    Error::learned("running a policy", error)
}

/// Answers a batch and checks what came: one entry for each turn, every value finite.
pub(super) fn answer<M: Model>(model: &M, turns: &[&Turn<M::History>]) -> Result<Vec<Advanced<M::History>>> {
    let advanced = guarded("running a policy", || model.advance(turns))?;
    if advanced.len() != turns.len() {
        return Err(Error::internal("running a policy", "it gave another number of answers than it was asked"));
    }
    for turn in &advanced {
        let right =
            |action: &Vec<f32>| action.len() == model.shape().action && action.iter().all(|value| value.is_finite());
        if turn.actions.is_empty() || !turn.actions.iter().all(right) {
            return Err(Error::internal("running a policy", "it gave an action that is not finite or of another size"));
        }
    }
    Ok(advanced)
}
