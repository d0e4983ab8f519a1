//! The chunks of one policy in one episode, counted in control steps. Plain data: must not know sessions or policies.

use super::{ChunkError, Ensemble, Execution};
use crate::action::ActionRanges;

/// The chunks that are executed in one episode, and its newest control step.
#[derive(Clone, Debug)]
pub struct StepChunks {
    chunks: Ensemble,
    /// The newest step; the first is 1.
    step: u64,
}

impl StepChunks {
    /// Those at the start of an episode.
    #[must_use]
    pub fn new(ranges: ActionRanges, execution: Execution) -> Self {
        let mut chunks = Ensemble::new(1, ranges);
        chunks.set_execution(execution);
        Self { chunks, step: 0 }
    }

    /// Changes the values that an action may take.
    pub fn set_ranges(&mut self, ranges: ActionRanges) {
        self.chunks.set_ranges(ranges);
    }

    /// Changes how chunks are executed.
    pub fn set_execution(&mut self, execution: Execution) {
        self.chunks.set_execution(execution);
    }

    /// Counts control steps.
    pub fn skip(&mut self, steps: u64) {
        self.step = self.step.saturating_add(steps);
    }

    /// Whether the policy has to predict after this many further steps; if not, its last chunk still gives the actions.
    #[must_use]
    pub fn predicts_after(&self, steps: u64) -> bool {
        i64::try_from(self.step.saturating_add(steps)).is_ok_and(|time| self.chunks.remaining(time).is_none())
    }

    /// The actions from the newest step on that the last chunk still gives; `None` when the policy has to predict.
    #[must_use]
    pub fn remaining(&self) -> Option<Vec<Vec<f32>>> {
        let time = self.time();
        let mut actions = self.chunks.remaining(time)?.to_vec();
        if let (Some(first), Some(now)) = (actions.first_mut(), self.chunks.action(time)) {
            *first = now;
        }
        Some(actions)
    }

    /// Adds the chunk predicted for the newest step, and returns it with its first action replaced by the one to
    /// execute.
    ///
    /// # Errors
    /// [`ChunkError`]; the chunks stay as they are.
    pub fn push(&mut self, mut chunk: Vec<Vec<f32>>) -> Result<Vec<Vec<f32>>, ChunkError> {
        let time = self.time();
        self.chunks.push(time, chunk.clone())?;
        // The chunk that was just added covers its own step.
        if let (Some(first), Some(now)) = (chunk.first_mut(), self.chunks.action(time)) {
            *first = now;
        }
        Ok(chunk)
    }

    /// The newest step as a time of the chunks. No episode has 2^63 steps.
    fn time(&self) -> i64 {
        i64::try_from(self.step).unwrap_or(i64::MAX)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chunk(first: f32) -> Vec<Vec<f32>> {
        vec![vec![first], vec![first + 1.0], vec![first + 2.0]]
    }

    #[test]
    fn the_rest_of_a_chunk_serves_until_its_horizon() {
        let mut steps = StepChunks::new(ActionRanges::default(), Execution::Horizon(2));
        assert!(steps.predicts_after(1) && steps.remaining().is_none());
        steps.skip(1);
        assert_eq!(steps.push(chunk(1.0)).unwrap(), chunk(1.0));
        assert!(!steps.predicts_after(1) && steps.predicts_after(2));
        steps.skip(1);
        assert_eq!(steps.remaining().unwrap(), chunk(1.0)[1..]);
        steps.skip(1);
        assert_eq!((steps.remaining(), steps.push(chunk(9.0)).unwrap()), (None, chunk(9.0)));
        assert!(matches!(steps.push(chunk(9.0)), Err(ChunkError::Order { last: 3 })));
    }

    #[test]
    fn with_a_horizon_of_one_every_step_predicts_its_own_actions() {
        for first in [Execution::Horizon(2), Execution::Ensembled] {
            let mut steps = StepChunks::new(ActionRanges::default(), first);
            steps.set_execution(Execution::Horizon(1));
            for value in [0.0, 3.0, 9.0] {
                assert!(steps.predicts_after(1), "{first:?}");
                steps.skip(1);
                assert_eq!((steps.remaining(), steps.push(chunk(value)).unwrap()), (None, chunk(value)), "{first:?}");
            }
        }
    }

    #[test]
    fn ensembled_chunks_begin_with_the_mean() {
        let mut steps = StepChunks::new(ActionRanges::default(), Execution::Ensembled);
        steps.skip(1);
        steps.push(chunk(0.0)).unwrap();
        steps.skip(1);
        let actions = steps.push(chunk(3.0)).unwrap();
        assert!(actions[0][0] > 1.9 && actions[0][0] < 2.1, "{actions:?}");
        assert_eq!(actions[1..], chunk(3.0)[1..]);
    }
}
