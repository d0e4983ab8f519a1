//! The action buffer: chunks of actions by the stamp of their observation, and the action due at a given time.
//!
//! Plain data: must not know clocks, robots or servers.

use std::time::Duration;

use gleaner_core::action::ActionRanges;
use gleaner_core::ensemble::{ChunkError, Ensemble, Execution};

use crate::error::{ClientError, Result};

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

/// The chunks that cover the present or the future, by the stamps of their observations in nanoseconds.
///
/// Action i of a chunk is for its observation's stamp plus i control periods; stamps may be off by half a period.
#[derive(Clone, Debug)]
pub struct ActionBuffer {
    ensembling: Ensembling,
    chunks: Ensemble,
}

impl ActionBuffer {
    /// An empty buffer for chunks with one action per period (at least 1 ns).
    #[must_use]
    pub fn new(period: Duration, ensembling: Ensembling) -> Self {
        let period_ns = i64::try_from(period.as_nanos()).unwrap_or(i64::MAX);
        Self { ensembling, chunks: Ensemble::new(period_ns, ActionRanges::default()) }
    }

    /// Sets the values that the robot executes: the ranges of the opened session.
    pub fn set_ranges(&mut self, ranges: ActionRanges) {
        self.chunks.set_ranges(ranges);
    }

    /// Sets how the policy's chunks are executed, as the opened session states it.
    pub fn set_execution(&mut self, execution: Execution) {
        self.chunks.set_execution(execution);
    }

    /// Adds the chunk that answers the observation of this stamp, and removes chunks that end before it.
    ///
    /// # Errors
    /// [`ClientError::Invalid`] when it is empty, not finite, not newer than the last, or its actions do not have the
    /// length of the earlier ones.
    pub fn push(&mut self, stamp_ns: i64, actions: Vec<Vec<f32>>) -> Result<()> {
        let problem = |problem: String| ClientError::Invalid(format!("the policy's actions: {problem}"));
        if actions.iter().flatten().any(|value| !value.is_finite()) {
            return Err(problem("a value is not finite; retrain the policy or deploy another".into()));
        }
        self.chunks.push(stamp_ns, actions).map_err(|error| {
            problem(match error {
                ChunkError::Empty => {
                    "the response has no actions; check that the deployment's policy is a gleaner policy".into()
                }
                ChunkError::Width { found, width, .. } => format!("an action has {found} values, the others {width}"),
                ChunkError::Order { last } => format!("the actions of stamp {stamp_ns} arrived after those of {last}"),
            })
        })
    }

    /// The action for this time; `None` when no chunk covers it. Removes chunks that end before it.
    pub fn due(&mut self, at_ns: i64) -> Option<Vec<f32>> {
        self.chunks.forget_before(at_ns);
        if self.ensembling == Ensembling::ByServer
            && let Some(action) = self.chunks.first(at_ns)
        {
            return Some(action.to_vec());
        }
        self.chunks.action(at_ns)
    }

    /// Whether the newest chunk covers this time or a later one.
    #[must_use]
    pub fn reaches(&self, at_ns: i64) -> bool {
        self.chunks.reaches(at_ns)
    }

    /// Removes every chunk, for a new episode or policy.
    pub fn clear(&mut self) {
        self.chunks.clear();
    }
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

    /// A server slower than the control rate: the rest of a chunk is executed until the next one arrives, and is then
    /// replaced from its present action on.
    #[test]
    fn under_a_horizon_a_late_chunk_replaces_the_rest_of_the_one_before() {
        let mut buffer = ActionBuffer::new(PERIOD, Ensembling::ByServer);
        buffer.set_execution(Execution::Horizon(2));
        buffer.push(1000, chunk(&[1.0, 2.0, 3.0, 4.0])).unwrap();
        for (at, due) in [(1000, 1.0), (1100, 2.0), (1200, 3.0)] {
            assert_near(buffer.due(at), due);
        }
        buffer.push(1200, chunk(&[50.0, 60.0, 70.0, 80.0])).unwrap();
        assert_near(buffer.due(1300), 60.0);
        // The server repeats the rest of a chunk for an observation that needs no new one.
        buffer.push(1400, chunk(&[70.0, 80.0])).unwrap();
        assert_near(buffer.due(1400), 70.0);
        assert_eq!(buffer.due(1600), None);
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
        for (stamp, actions, message) in [
            (1100, vec![], "has no actions"),
            (1100, vec![vec![1.0], vec![1.0, 2.0]], "2 values, the others 1"),
            (1100, vec![vec![1.0, 2.0]], "2 values, the others 1"),
            (1100, chunk(&[f32::NAN]), "not finite"),
            (1000, chunk(&[1.0]), "arrived after"),
        ] {
            let error = buffer.push(stamp, actions).unwrap_err().to_string();
            assert!(error.contains(message), "{error}");
        }
        assert_near(buffer.due(1100), 2.0);
        buffer.clear();
        buffer.push(500, vec![vec![1.0, 2.0]]).unwrap();
    }
}
