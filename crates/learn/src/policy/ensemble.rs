//! Temporal ensembling in a session: chunks by control step. The mean is that of `gleaner_core`.

use gleaner_core::action::ActionRanges;
use gleaner_core::ensemble::{self, ChunkError};

use crate::error::LearnError;

/// The chunks of a session that cover the present or the future.
///
/// Every control step a chunk of k actions is predicted, so up to k chunks cover each step. The action for a step is
/// their mean with weights `exp(-0.01 i)`, i = 0 the oldest: a new observation changes the motion gradually. Binary values
/// are those of the newest chunk.
#[derive(Debug, Clone)]
pub struct Ensemble(ensemble::Ensemble);

impl Ensemble {
    /// One without chunks, of actions with these ranges.
    pub fn new(ranges: ActionRanges) -> Self {
        Self(ensemble::Ensemble::new(1, ranges))
    }

    /// Adds the chunk predicted at `step`, whose first action is for that step, and returns the action for it. Steps
    /// that were skipped count: the predictions of older chunks for `step` are used, and chunks that do not reach it
    /// are removed.
    ///
    /// # Errors
    /// [`LearnError::Invalid`] if the chunk is empty, its actions differ in length, or `step` is not after the step
    /// before.
    pub fn push(&mut self, step: u64, chunk: Vec<Vec<f32>>) -> Result<Vec<f32>, LearnError> {
        let time =
            i64::try_from(step).map_err(|_| LearnError::invalid("step", "is too high; reset for a new episode"))?;
        self.0.push(time, chunk).map_err(|problem| match problem {
            ChunkError::Empty => LearnError::invalid("chunk", "is empty; push the actions of the policy"),
            ChunkError::Width { .. } => LearnError::invalid("chunk", format!("{problem}; reset before another policy")),
            ChunkError::Order { last } => {
                LearnError::invalid("step", format!("is {step}, must be after {last}; reset for a new episode"))
            }
        })?;
        // The chunk that was just added covers its own step.
        Ok(self.0.action(time).unwrap_or_default())
    }

    /// Removes every chunk, for a new episode.
    pub fn reset(&mut self) {
        self.0.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chunk(values: &[f32]) -> Vec<Vec<f32>> {
        values.iter().map(|value| vec![*value]).collect()
    }

    #[test]
    fn the_oldest_opinion_weighs_most_and_what_is_past_is_forgotten() {
        let mut ensemble = Ensemble::new(ActionRanges::default());
        assert_eq!(ensemble.push(0, chunk(&[1.0, 2.0, 3.0])).unwrap(), [1.0]);
        let second = (-0.01f64).exp();
        let expected = (2.0 + second * 5.0) / (1.0 + second);
        assert!((f64::from(ensemble.push(1, chunk(&[5.0, 6.0, 7.0])).unwrap()[0]) - expected).abs() < 1e-6);
        let third = (-0.02f64).exp();
        let expected = (3.0 + second * 6.0 + third * 9.0) / (1.0 + second + third);
        assert!((f64::from(ensemble.push(2, chunk(&[9.0, 9.0, 9.0])).unwrap()[0]) - expected).abs() < 1e-6);
        // Step 3 was skipped: only the chunk of step 2 reaches step 4.
        let expected = (9.0 + second) / (1.0 + second);
        assert!((f64::from(ensemble.push(4, chunk(&[1.0])).unwrap()[0]) - expected).abs() < 1e-6);
        assert_eq!(ensemble.0.len(), 2);
        ensemble.reset();
        assert_eq!(ensemble.push(0, chunk(&[4.0])).unwrap(), [4.0]);
    }

    #[test]
    fn chunks_of_one_action_pass_through() {
        let mut ensemble = Ensemble::new(ActionRanges::default());
        for step in 0..4u8 {
            let action = vec![vec![f32::from(step), -0.1]];
            assert_eq!(ensemble.push(u64::from(step), action.clone()).unwrap(), action[0]);
        }
    }

    #[test]
    fn a_chunk_out_of_turn_or_shape_is_refused() {
        let mut ensemble = Ensemble::new(ActionRanges::default());
        assert!(ensemble.push(3, Vec::new()).unwrap_err().to_string().starts_with("chunk: "));
        ensemble.push(3, chunk(&[1.0, 2.0])).unwrap();
        assert!(ensemble.push(3, chunk(&[1.0])).unwrap_err().to_string().starts_with("step: "));
        let ragged = vec![vec![1.0], vec![1.0, 2.0]];
        assert!(ensemble.push(4, ragged).unwrap_err().to_string().starts_with("chunk: "));
    }
}
