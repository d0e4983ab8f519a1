//! The history of a session: plain data, which policies and scores read. Independent of both.

mod layout;

use std::collections::VecDeque;

pub(crate) use layout::{Layout, Stacked};

use crate::error::LearnError;

/// One step's images, encoded by [`Policy::embed`](crate::Policy::embed) or
/// [`LiveScorer::embed`](crate::LiveScorer::embed). Valid only for the model that made it.
#[derive(Debug, Clone, PartialEq)]
pub struct Embedding(Vec<f32>);

/// One remembered step.
#[derive(Debug, Clone)]
struct Step {
    embedding: Embedding,
    proprioception: Vec<f32>,
    /// The action that was executed; `None` until it is set.
    executed: Option<Vec<f32>>,
}

/// The last `l + 1` steps of a session: o_i … o_t, m_i … m_t and a_i … a_{t−1}.
///
/// In each control step: [`push`](History::push) the observation, call [`Policy::act`](crate::Policy::act) for an
/// action, then [`set_executed`](History::set_executed) the action that the robot executed.
#[derive(Debug, Clone)]
pub struct History {
    window: usize,
    steps: VecDeque<Step>,
    /// Of the numbers that are drawn for this history.
    seed: u64,
    /// Observations added, which numbers the draws.
    pushed: u64,
}

impl History {
    /// An empty history for a policy or scorer with this segment length l.
    pub fn new(segment_length: u32) -> Self {
        Self::seeded(segment_length, 0)
    }

    /// As [`History::new`]; a policy that draws its actions draws those of this history from `seed`.
    pub fn seeded(segment_length: u32, seed: u64) -> Self {
        Self { window: segment_length as usize + 1, steps: VecDeque::new(), seed, pushed: 0 }
    }

    /// Steps remembered, at most `l + 1`.
    pub fn len(&self) -> usize {
        self.steps.len()
    }

    /// Whether the history has no step yet.
    pub fn is_empty(&self) -> bool {
        self.steps.is_empty()
    }

    /// Whether the newest step's action is known.
    pub(crate) fn acted(&self) -> bool {
        self.steps.back().is_some_and(|step| step.executed.is_some())
    }

    /// Adds the newest observation; the oldest step is removed when there are more than `l + 1`.
    ///
    /// # Errors
    /// [`LearnError::Invalid`] if the action of the step before was never set, unless that step is removed by this
    /// call.
    pub fn push(&mut self, embedding: Embedding, proprioception: Vec<f32>) -> Result<(), LearnError> {
        if self.window > 1 && self.steps.back().is_some_and(|step| step.executed.is_none()) {
            return Err(LearnError::invalid(
                "executed",
                "the previous step's executed action is unknown; \
                 set it before the next observation",
            ));
        }
        if self.steps.len() == self.window {
            self.steps.pop_front();
        }
        self.steps.push_back(Step { embedding, proprioception, executed: None });
        self.pushed += 1;
        Ok(())
    }

    /// Sets the action that was executed at the newest step, in physical units. A second call replaces it.
    ///
    /// # Errors
    /// [`LearnError::Invalid`] if the history is empty.
    pub fn set_executed(&mut self, action: Vec<f32>) -> Result<(), LearnError> {
        match self.steps.back_mut() {
            Some(step) => {
                step.executed = Some(action);
                Ok(())
            }
            None => Err(LearnError::invalid("executed", "comes before any observation; push one first")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_last_steps_are_kept_and_order_is_enforced() {
        let mut history = History::new(1);
        assert!(history.set_executed(vec![0.0]).is_err());
        for t in 0..3u8 {
            history.push(Embedding(vec![f32::from(t)]), vec![f32::from(t)]).unwrap();
            assert!(history.push(Embedding(vec![]), vec![]).is_err());
            history.set_executed(vec![f32::from(t)]).unwrap();
        }
        let kept: Vec<f32> = history.steps.iter().map(|step| step.proprioception[0]).collect();
        assert_eq!(kept, [1.0, 2.0]);
    }
}
