//! The action buffer: chunks of actions by the stamp of their observation, and the action due at a given time.
//!
//! Plain data: must not know clocks, robots or servers.

use std::collections::VecDeque;
use std::time::Duration;

use crate::error::{ClientError, Result};

/// The decay of a prediction's weight with its rank by age: `exp(-DECAY * i)`, i = 0 the oldest.
const DECAY: f64 = 0.01;

/// Where the predictions of several chunks for one step are ensembled.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Ensembling {
    /// On the server, as gleaner's does: the first action of an answer is already the ensemble of all chunks of the
    /// session and is taken as it is. A step without an answer of its own gets the mean of what earlier chunks
    /// predicted for it.
    #[default]
    ByServer,
    /// On the client: every step gets the mean of all chunks that cover it. For servers that send chunks as predicted.
    ByClient,
}

/// The chunks that cover the present or the future.
///
/// Action i of a chunk is for its observation's stamp plus i control periods. The mean of several predictions for one
/// step has the weights `exp(-0.01 i)`, i = 0 the oldest.
#[derive(Clone, Debug)]
pub struct ActionBuffer {
    period_ns: i64,
    ensembling: Ensembling,
    /// Oldest first.
    chunks: VecDeque<Chunk>,
}

#[derive(Clone, Debug)]
struct Chunk {
    stamp_ns: i64,
    actions: Vec<Vec<f32>>,
}

impl Chunk {
    /// The index of the action nearest to this time, if the chunk covers it; stamps may be off by half a period.
    fn index(&self, at_ns: i64, period_ns: i64) -> Option<usize> {
        let steps = at_ns.saturating_sub(self.stamp_ns).saturating_add(period_ns / 2).div_euclid(period_ns);
        usize::try_from(steps).ok().filter(|&index| index < self.actions.len())
    }
}

impl ActionBuffer {
    /// An empty buffer for chunks with one action per period (at least 1 ns).
    #[must_use]
    pub fn new(period: Duration, ensembling: Ensembling) -> Self {
        let period_ns = i64::try_from(period.as_nanos()).unwrap_or(i64::MAX).max(1);
        Self { period_ns, ensembling, chunks: VecDeque::new() }
    }

    /// Adds the chunk that answers the observation of this stamp, and removes chunks that end before it.
    ///
    /// # Errors
    /// [`ClientError::Invalid`] when it is empty, not finite, not newer than the last, or its actions do not have the
    /// length of the earlier ones.
    pub fn push(&mut self, stamp_ns: i64, actions: Vec<Vec<f32>>) -> Result<()> {
        self.check(stamp_ns, &actions)?;
        self.forget_before(stamp_ns);
        self.chunks.push_back(Chunk { stamp_ns, actions });
        Ok(())
    }

    /// The action for this time; `None` when no chunk covers it. Removes chunks that end before it.
    pub fn due(&mut self, at_ns: i64) -> Option<Vec<f32>> {
        self.forget_before(at_ns);
        let period_ns = self.period_ns;
        let opinions = || self.chunks.iter().filter_map(|chunk| Some((chunk, chunk.index(at_ns, period_ns)?)));
        if self.ensembling == Ensembling::ByServer
            && let Some((chunk, 0)) = opinions().next_back()
        {
            return chunk.actions.first().cloned();
        }
        mean(opinions().filter_map(|(chunk, index)| chunk.actions.get(index)))
    }

    /// Whether the newest chunk covers this time or a later one.
    #[must_use]
    pub fn reaches(&self, at_ns: i64) -> bool {
        let reaches = |chunk: &Chunk| chunk.stamp_ns > at_ns || chunk.index(at_ns, self.period_ns).is_some();
        self.chunks.back().is_some_and(reaches)
    }

    /// Removes every chunk, for a new episode or policy.
    pub fn clear(&mut self) {
        self.chunks.clear();
    }

    fn forget_before(&mut self, at_ns: i64) {
        let period_ns = self.period_ns;
        // A chunk whose stamp is ahead of this time stays.
        self.chunks.retain(|chunk| chunk.stamp_ns > at_ns || chunk.index(at_ns, period_ns).is_some());
    }

    fn check(&self, stamp_ns: i64, actions: &[Vec<f32>]) -> Result<()> {
        let problem = |problem: String| Err(ClientError::Invalid(format!("the policy's actions: {problem}")));
        let Some(first) = actions.first() else {
            return problem("the answer has none; check that the deployment's policy is a gleaner policy".into());
        };
        let newest = self.chunks.back();
        let width = newest.and_then(|chunk| chunk.actions.first()).unwrap_or(first).len();
        if let Some(other) = actions.iter().find(|action| action.len() != width) {
            return problem(format!("one has {} values, the others {width}", other.len()));
        }
        if actions.iter().flatten().any(|value| !value.is_finite()) {
            return problem("a value is not finite; retrain the policy or deploy another".into());
        }
        match newest {
            Some(newest) if stamp_ns <= newest.stamp_ns => {
                problem(format!("those of stamp {stamp_ns} came after those of {}", newest.stamp_ns))
            }
            _ => Ok(()),
        }
    }
}

/// The weighted mean of predictions, oldest first; `None` of an empty list.
fn mean<'a>(opinions: impl Iterator<Item = &'a Vec<f32>>) -> Option<Vec<f32>> {
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
    let mean = |sum: f64| (sum / weights) as f32;
    (weights > 0.0).then(|| sum.into_iter().map(mean).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD: Duration = Duration::from_nanos(100);

    fn chunk(values: &[f32]) -> Vec<Vec<f32>> {
        values.iter().map(|value| vec![*value]).collect()
    }

    fn assert_near(action: Option<Vec<f32>>, expected: f64) {
        let action = action.unwrap();
        assert_eq!(action.len(), 1);
        assert!((f64::from(action[0]) - expected).abs() < 1e-6, "{action:?}, not {expected}");
    }

    #[test]
    fn the_oldest_prediction_weighs_most_and_past_chunks_are_removed() {
        let mut buffer = ActionBuffer::new(PERIOD, Ensembling::ByClient);
        let (second, third) = ((-0.01f64).exp(), (-0.02f64).exp());
        buffer.push(1000, chunk(&[1.0, 2.0, 3.0])).unwrap();
        assert_near(buffer.due(1000), 1.0);
        buffer.push(1100, chunk(&[5.0, 6.0, 7.0])).unwrap();
        assert_near(buffer.due(1100), (2.0 + second * 5.0) / (1.0 + second));
        buffer.push(1200, chunk(&[9.0, 9.0, 9.0])).unwrap();
        assert_near(buffer.due(1200), (3.0 + second * 6.0 + third * 9.0) / (1.0 + second + third));
        // A step was skipped: only the last chunk still covers it.
        buffer.push(1400, chunk(&[1.0])).unwrap();
        assert_near(buffer.due(1400), (9.0 + second) / (1.0 + second));
        assert_eq!(buffer.chunks.len(), 2);
        assert_eq!(buffer.due(1500), None);
        assert!(buffer.chunks.is_empty());
    }

    #[test]
    fn actions_ensembled_by_the_server_are_taken_unchanged() {
        let mut buffer = ActionBuffer::new(PERIOD, Ensembling::ByServer);
        buffer.push(1000, chunk(&[1.0, 2.0, 3.0, 4.0])).unwrap();
        buffer.push(1100, chunk(&[5.0, 6.0, 7.0])).unwrap();
        assert_near(buffer.due(1100), 5.0);
        // Without an answer to 1200: the mean of both predictions.
        let second = (-0.01f64).exp();
        assert_near(buffer.due(1200), (3.0 + second * 6.0) / (1.0 + second));
    }

    #[test]
    fn stamps_are_matched_to_the_nearest_period() {
        let mut buffer = ActionBuffer::new(PERIOD, Ensembling::ByClient);
        buffer.push(1000, chunk(&[1.0, 2.0, 3.0])).unwrap();
        for (at, due) in [(960, 1.0), (1049, 1.0), (1050, 2.0), (1149, 2.0), (1249, 3.0)] {
            assert_near(buffer.due(at), due);
        }
        assert_eq!(buffer.due(900), None);
        assert_near(buffer.due(1000), 1.0);
        assert_eq!(buffer.due(1250), None);
    }

    #[test]
    fn invalid_chunks_are_rejected_and_change_nothing() {
        let mut buffer = ActionBuffer::new(PERIOD, Ensembling::ByClient);
        buffer.push(1000, chunk(&[1.0, 2.0])).unwrap();
        for (stamp, actions, said) in [
            (1100, vec![], "the answer has none"),
            (1100, vec![vec![1.0], vec![1.0, 2.0]], "2 values, the others 1"),
            (1100, vec![vec![1.0, 2.0]], "2 values, the others 1"),
            (1100, chunk(&[f32::NAN]), "not finite"),
            (1000, chunk(&[1.0]), "came after"),
        ] {
            let error = buffer.push(stamp, actions).unwrap_err().to_string();
            assert!(error.contains(said), "{error}");
        }
        assert_near(buffer.due(1100), 2.0);
        buffer.clear();
        buffer.push(500, vec![vec![1.0, 2.0]]).unwrap();
    }
}
