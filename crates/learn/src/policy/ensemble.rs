//! Temporal ensembling: the predictions of several chunks for one step become one action. Plain data, stored beside a
//! session's history; must not depend on the policy that predicts the chunks.

use std::collections::VecDeque;

use crate::error::LearnError;

/// The decay of a prediction's weight with its age rank: `exp(-DECAY * i)`.
const DECAY: f64 = 0.01;

/// The chunks of a session that still cover a coming step.
///
/// A chunk of k actions is predicted at every control step, so up to k chunks cover each step. The action for a step is
/// their mean with weights `exp(-0.01 i)`, i = 0 the oldest, so that a new observation changes the motion smoothly.
#[derive(Debug, Clone, Default)]
pub struct Ensemble {
    /// (the step its first action is for, its actions), oldest first.
    chunks: VecDeque<(u64, Vec<Vec<f32>>)>,
}

impl Ensemble {
    /// An ensemble without chunks.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds the chunk predicted at `step`, whose first action is for that step, and returns the action for it. Skipped
    /// steps count: an older chunk's prediction for `step` is used, and chunks that do not reach it are removed.
    ///
    /// # Errors
    /// [`LearnError::Invalid`] if the chunk is empty, its actions differ in length, or `step` is not
    /// after the step before.
    pub fn push(&mut self, step: u64, chunk: Vec<Vec<f32>>) -> Result<Vec<f32>, LearnError> {
        self.check(step, &chunk)?;
        self.chunks.retain(|(begin, actions)| foreseen(*begin, actions, step).is_some());
        self.chunks.push_back((step, chunk));
        let opinions = self.chunks.iter().filter_map(|(begin, actions)| foreseen(*begin, actions, step));
        let (mut sum, mut weights, mut weight) = (Vec::new(), 0.0, 1.0);
        for action in opinions {
            sum.resize(action.len(), 0.0);
            for (sum, value) in sum.iter_mut().zip(action) {
                *sum += weight * f64::from(*value);
            }
            weights += weight;
            weight *= (-DECAY).exp();
        }
        #[expect(clippy::cast_possible_truncation, reason = "a mean of f32 values fits one")]
        Ok(sum.into_iter().map(|sum| (sum / weights) as f32).collect())
    }

    /// Removes all chunks, for a new episode.
    pub fn reset(&mut self) {
        self.chunks.clear();
    }

    fn check(&self, step: u64, chunk: &[Vec<f32>]) -> Result<(), LearnError> {
        let Some(first) = chunk.first() else {
            return Err(LearnError::invalid("chunk", "is empty; push what the policy gave"));
        };
        let before = self.chunks.back();
        let width = before.and_then(|(_, actions)| actions.first()).unwrap_or(first).len();
        if let Some(at) = chunk.iter().position(|action| action.len() != width) {
            let found = chunk[at].len();
            let message = format!("action {at} has {found} values, the others {width}; reset before another policy");
            return Err(LearnError::invalid("chunk", message));
        }
        match before {
            Some((last, _)) if step <= *last => {
                let message = format!("is {step}, must be after {last}; reset for a new episode");
                Err(LearnError::invalid("step", message))
            }
            _ => Ok(()),
        }
    }
}

/// The action of a chunk starting at `begin` for `step`, if it reaches it.
fn foreseen(begin: u64, actions: &[Vec<f32>], step: u64) -> Option<&Vec<f32>> {
    actions.get(usize::try_from(step - begin).ok()?)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chunk(values: &[f32]) -> Vec<Vec<f32>> {
        values.iter().map(|value| vec![*value]).collect()
    }

    #[test]
    fn the_oldest_opinion_weighs_most_and_what_is_past_is_forgotten() {
        let mut ensemble = Ensemble::new();
        assert_eq!(ensemble.push(0, chunk(&[1.0, 2.0, 3.0])).unwrap(), [1.0]);
        let second = (-0.01f64).exp();
        let expected = (2.0 + second * 5.0) / (1.0 + second);
        assert!((f64::from(ensemble.push(1, chunk(&[5.0, 6.0, 7.0])).unwrap()[0]) - expected).abs() < 1e-6);
        let third = (-0.02f64).exp();
        let expected = (3.0 + second * 6.0 + third * 9.0) / (1.0 + second + third);
        assert!((f64::from(ensemble.push(2, chunk(&[9.0, 9.0, 9.0])).unwrap()[0]) - expected).abs() < 1e-6);
        // Step 3 was skipped: at 4 only the chunk of step 2 still counts.
        let expected = (9.0 + second) / (1.0 + second);
        assert!((f64::from(ensemble.push(4, chunk(&[1.0])).unwrap()[0]) - expected).abs() < 1e-6);
        assert_eq!(ensemble.chunks.len(), 2);
        ensemble.reset();
        assert_eq!(ensemble.push(0, chunk(&[4.0])).unwrap(), [4.0]);
    }

    #[test]
    fn chunks_of_one_action_pass_through() {
        let mut ensemble = Ensemble::new();
        for step in 0..4u8 {
            let action = vec![vec![f32::from(step), -0.1]];
            assert_eq!(ensemble.push(u64::from(step), action.clone()).unwrap(), action[0]);
        }
    }

    #[test]
    fn a_chunk_out_of_turn_or_shape_is_refused() {
        let mut ensemble = Ensemble::new();
        assert!(ensemble.push(3, Vec::new()).unwrap_err().to_string().starts_with("chunk: "));
        ensemble.push(3, chunk(&[1.0, 2.0])).unwrap();
        assert!(ensemble.push(3, chunk(&[1.0])).unwrap_err().to_string().starts_with("step: "));
        let ragged = vec![vec![1.0], vec![1.0, 2.0]];
        assert!(ensemble.push(4, ragged).unwrap_err().to_string().starts_with("chunk: "));
    }
}
