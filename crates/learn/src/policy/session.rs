//! A policy in one running episode: the history it reads and the chunks that are executed. Independent of the kind of
//! policy, and of how sessions are served.

use gleaner_core::action::ActionRanges;
use gleaner_core::ensemble::{ChunkError, Execution, StepChunks};

use super::Policy;
use crate::error::LearnError;
use crate::history::History;

/// The state of a policy in one episode.
#[derive(Debug, Clone)]
pub struct PolicySession {
    history: History,
    chunks: StepChunks,
}

/// One step of an episode.
#[derive(Debug, Clone, Copy)]
pub struct Observed<'a> {
    /// Images, in the layout of one step of [`StepSource`](crate::StepSource).
    pub frame: &'a [u8],
    /// In physical units.
    pub proprioception: &'a [f32],
    /// The action executed at the step before; `None` for the first step.
    pub executed: Option<&'a [f32]>,
}

impl PolicySession {
    /// The same session of a robot that executes only values in these ranges.
    pub fn within(mut self, ranges: ActionRanges) -> Self {
        self.chunks.set_ranges(ranges);
        self
    }

    /// The same session with another execution of its chunks.
    pub fn executing(mut self, execution: Execution) -> Self {
        self.chunks.set_execution(execution);
        self
    }

    /// Counts control steps that passed without an observation.
    pub fn skip(&mut self, steps: u64) {
        self.chunks.skip(steps);
    }

    /// Whether the policy has to predict after this many further steps; if not, its last chunk still gives the actions.
    pub fn predicts_after(&self, steps: u64) -> bool {
        self.chunks.predicts_after(steps)
    }

    /// Adds the chunk predicted for the newest step, and returns it with its first action replaced by the one to
    /// execute.
    fn push(&mut self, chunk: Vec<Vec<f32>>) -> Result<Vec<Vec<f32>>, LearnError> {
        self.chunks.push(chunk).map_err(|problem| match problem {
            ChunkError::Empty => LearnError::invalid("chunk", "is empty; push the actions of the policy"),
            ChunkError::Width { .. } => LearnError::invalid("chunk", format!("{problem}; reset before another policy")),
            ChunkError::Order { last } => {
                LearnError::invalid("step", format!("must be after {last}; reset for a new episode"))
            }
        })
    }
}

impl Policy {
    /// A session at the start of an episode. A policy that draws its actions draws them from `seed`: the same seed and
    /// observations give the same actions, also in a pass with other sessions.
    pub fn session(&self, seed: u64) -> PolicySession {
        let chunks = StepChunks::new(self.shape().ranges.clone(), self.execution());
        PolicySession { history: History::seeded(self.segment_length(), seed), chunks }
    }

    /// How the chunks of this policy are executed.
    pub fn execution(&self) -> Execution {
        Execution::of_horizon(self.horizon())
    }

    /// Adds the new steps of each session, oldest first, and returns the actions from its newest step on, in physical
    /// units and within the ranges; the first one is to be executed. One pass for all. A session whose last chunk is
    /// not executed yet takes no part in it.
    ///
    /// # Errors
    /// [`LearnError::Invalid`] if a step does not fit the policy's shape or is not finite, or the action before it is
    /// not known; discard the sessions then.
    pub fn advance(
        &self,
        sessions: &mut [(&mut PolicySession, &[Observed<'_>])],
    ) -> Result<Vec<Vec<Vec<f32>>>, LearnError> {
        let mut answers = Vec::with_capacity(sessions.len());
        for (session, steps) in &mut *sessions {
            session.skip(steps.len() as u64);
            answers.push(session.chunks.remaining());
        }
        // A history of one step is replaced by the next one, so that a step without a pass need not be encoded.
        let reads = |answer: &Option<_>| answer.is_none() || self.segment_length() > 0;
        let reading = || answers.iter().enumerate().filter(|(_, answer)| reads(answer)).map(|(at, _)| at);
        let frames: Vec<&[u8]> = reading().flat_map(|at| sessions[at].1).map(|step| step.frame).collect();
        let mut embeddings = self.embed(&frames)?.into_iter();
        for at in reading() {
            let (session, steps) = &mut sessions[at];
            for (step, embedding) in steps.iter().zip(embeddings.by_ref()) {
                if let Some(executed) = step.executed {
                    session.history.set_executed(executed.to_vec())?;
                }
                session.history.push(embedding, step.proprioception.to_vec())?;
            }
        }
        let predicting = || answers.iter().enumerate().filter(|(_, answer)| answer.is_none()).map(|(at, _)| at);
        let histories: Vec<&History> = predicting().map(|at| &sessions[at].0.history).collect();
        let chunks = self.act(&histories)?;
        let predicting: Vec<usize> = predicting().collect();
        for (at, chunk) in predicting.into_iter().zip(chunks) {
            answers[at] = Some(sessions[at].0.push(chunk)?);
        }
        Ok(answers.into_iter().flatten().collect())
    }
}
