//! The execution of action chunks: several predictions for one time become one action.
//!
//! Plain data: must not know clocks, sessions or policies.

mod execution;
mod steps;

pub use execution::Execution;
pub use steps::StepChunks;

use std::collections::VecDeque;

use crate::action::ActionRanges;

/// The decay of a prediction's weight with its rank by age: `exp(-DECAY * i)`, i = 0 the oldest.
const DECAY: f64 = 0.01;

/// The chunks of actions that cover the present or the future.
///
/// Action i of a chunk is for the chunk's time plus i periods. The mean of several predictions for one time has the
/// weights `exp(-0.01 i)`, i = 0 the oldest: a new observation changes the motion gradually. Of a binary value the newest
/// prediction counts, because a mean of "close" and "open" is neither. Under [`Execution::Horizon`] the newest chunk
/// counts for every value. The action is one that the robot executes.
#[derive(Clone, Debug)]
pub struct Ensemble {
    period: i64,
    ranges: ActionRanges,
    execution: Execution,
    /// Oldest first.
    chunks: VecDeque<Chunk>,
}

#[derive(Clone, Debug)]
struct Chunk {
    time: i64,
    actions: Vec<Vec<f32>>,
}

/// Why a chunk does not fit those before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ChunkError {
    /// It has no actions.
    #[error("it is empty")]
    Empty,
    /// Its actions differ in length, from each other or from those of earlier chunks.
    #[error("action {index} has {found} values, the others {width}")]
    Width {
        /// The first action of another length.
        index: usize,
        /// Its values.
        found: usize,
        /// The values of the others.
        width: usize,
    },
    /// Its time is not after that of the last chunk.
    #[error("it must be after {last}")]
    Order {
        /// The last chunk's time.
        last: i64,
    },
}

impl Chunk {
    /// The action nearest to this time with its index, if the chunk covers it; times may be off by half a period.
    fn at(&self, time: i64, period: i64) -> Option<(usize, &Vec<f32>)> {
        let steps = time.saturating_sub(self.time).saturating_add(period / 2).div_euclid(period);
        let index = usize::try_from(steps).ok()?;
        Some((index, self.actions.get(index)?))
    }
}

impl Ensemble {
    /// One without chunks; `period` (at least 1) is the time between two actions of a chunk, and `ranges` has the values
    /// that an action may take.
    #[must_use]
    pub fn new(period: i64, ranges: ActionRanges) -> Self {
        Self { period: period.max(1), ranges, execution: Execution::default(), chunks: VecDeque::new() }
    }

    /// Changes how chunks are executed.
    pub fn set_execution(&mut self, execution: Execution) {
        self.execution = execution;
    }

    /// Changes the values that an action may take.
    pub fn set_ranges(&mut self, ranges: ActionRanges) {
        self.ranges = ranges;
    }

    /// Adds the chunk whose first action is for this time, and removes chunks that end before it.
    ///
    /// # Errors
    /// [`ChunkError`]; the chunks stay as they are.
    pub fn push(&mut self, time: i64, actions: Vec<Vec<f32>>) -> Result<(), ChunkError> {
        let first = actions.first().ok_or(ChunkError::Empty)?;
        let newest = self.chunks.back();
        let width = newest.and_then(|chunk| chunk.actions.first()).unwrap_or(first).len();
        if let Some(index) = actions.iter().position(|action| action.len() != width) {
            return Err(ChunkError::Width { index, found: actions[index].len(), width });
        }
        if let Some(newest) = newest.filter(|newest| time <= newest.time) {
            return Err(ChunkError::Order { last: newest.time });
        }
        self.forget_before(time);
        self.chunks.push_back(Chunk { time, actions });
        Ok(())
    }

    /// The action for this time: the weighted mean of all predictions for it, and the newest one of binary values; under
    /// a horizon that of the newest chunk. `None` when no chunk covers it.
    #[must_use]
    pub fn action(&self, time: i64) -> Option<Vec<f32>> {
        if let Execution::Horizon(_) = self.execution {
            let (_, action) = self.chunks.iter().rev().find_map(|chunk| chunk.at(time, self.period))?;
            let mut action = action.clone();
            self.ranges.apply(&mut action);
            return Some(action);
        }
        let (mut sum, mut weights, mut weight) = (Vec::new(), 0.0, 1.0);
        let mut newest: &[f32] = &[];
        for (_, action) in self.chunks.iter().filter_map(|chunk| chunk.at(time, self.period)) {
            newest = action;
            sum.resize(action.len(), 0.0);
            for (sum, value) in sum.iter_mut().zip(action) {
                *sum += weight * f64::from(*value);
            }
            weights += weight;
            weight *= (-DECAY).exp();
        }
        #[expect(clippy::cast_possible_truncation, reason = "a mean of f32 values fits one")]
        let mean = |sum: f64| (sum / weights) as f32;
        if weights == 0.0 {
            return None;
        }
        let of = |(index, sum)| if self.ranges.is_binary(index) { newest[index] } else { mean(sum) };
        let mut action: Vec<f32> = sum.into_iter().enumerate().map(of).collect();
        self.ranges.apply(&mut action);
        Some(action)
    }

    /// The first action of the newest chunk that covers this time, if it is for this time.
    #[must_use]
    pub fn first(&self, time: i64) -> Option<&[f32]> {
        match self.chunks.iter().rev().find_map(|chunk| chunk.at(time, self.period))? {
            (0, action) => Some(action),
            _ => None,
        }
    }

    /// The newest chunk's actions from this time on, while fewer of them than the horizon were executed; `None` when the
    /// next chunk is wanted, which is always so without a horizon.
    #[must_use]
    pub fn remaining(&self, time: i64) -> Option<&[Vec<f32>]> {
        let Execution::Horizon(horizon) = self.execution else { return None };
        let chunk = self.chunks.back()?;
        let (executed, _) = chunk.at(time, self.period).filter(|(index, _)| (*index as u64) < u64::from(horizon))?;
        chunk.actions.get(executed..)
    }

    /// Whether the newest chunk covers this time or a later one.
    #[must_use]
    pub fn reaches(&self, time: i64) -> bool {
        self.chunks.back().is_some_and(|chunk| chunk.time > time || chunk.at(time, self.period).is_some())
    }

    /// Removes the chunks that end before this time; one whose time is ahead stays.
    pub fn forget_before(&mut self, time: i64) {
        let period = self.period;
        self.chunks.retain(|chunk| chunk.time > time || chunk.at(time, period).is_some());
    }

    /// Removes every chunk, for a new episode or policy.
    pub fn clear(&mut self) {
        self.chunks.clear();
    }

    /// Number of chunks.
    #[must_use]
    pub fn len(&self) -> usize {
        self.chunks.len()
    }

    /// Whether there are no chunks.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.chunks.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Bound;
    use crate::FieldSpec;

    /// The mean as the server and the robot client computed it apart from each other, before they shared this module.
    fn earlier(predictions: &[Vec<f32>]) -> Vec<u32> {
        let (mut sum, mut weights, mut weight) = (vec![0.0f64; predictions[0].len()], 0.0, 1.0);
        for action in predictions {
            for (sum, value) in sum.iter_mut().zip(action) {
                *sum += weight * f64::from(*value);
            }
            weights += weight;
            weight *= (-0.01f64).exp();
        }
        #[expect(clippy::cast_possible_truncation, reason = "as it was")]
        sum.into_iter().map(|sum| ((sum / weights) as f32).to_bits()).collect()
    }

    #[test]
    fn means_have_the_same_bits_for_steps_and_for_stamps() {
        const LENGTH: u8 = 7;
        const PERIOD: i64 = 33_333_333;
        // Values with many bits of mantissa, as policies give them.
        let value = |chunk: u8, index: u8, axis: u8| {
            (f32::from(chunk) * 0.731 + f32::from(index) * 0.113 + f32::from(axis) * 1.7).sin() / 3.0
        };
        let chunk = |chunk: u8| -> Vec<Vec<f32>> {
            (0..LENGTH).map(|index| vec![value(chunk, index, 0), value(chunk, index, 1)]).collect()
        };
        let (mut steps, mut stamps) = (free(1), free(PERIOD));
        for now in 0..40u8 {
            // Stamps are a little late or early.
            let stamp = i64::from(now) * PERIOD + i64::from(now % 5) * 1_000_000 - 2_000_000;
            steps.push(now.into(), chunk(now)).unwrap();
            stamps.push(stamp, chunk(now)).unwrap();
            let covering = now.saturating_sub(LENGTH - 1)..=now;
            let predictions: Vec<Vec<f32>> =
                covering.map(|begin| vec![value(begin, now - begin, 0), value(begin, now - begin, 1)]).collect();
            for mean in [steps.action(now.into()), stamps.action(stamp)] {
                let bits: Vec<u32> = mean.unwrap().into_iter().map(f32::to_bits).collect();
                assert_eq!(bits, earlier(&predictions), "step {now}");
            }
        }
    }

    fn free(period: i64) -> Ensemble {
        Ensemble::new(period, ActionRanges::default())
    }

    #[test]
    fn a_binary_value_is_never_averaged_and_a_bounded_one_stays_within() {
        let bounded = |name| FieldSpec {
            minimum: Some(Bound::All(-1.0)),
            maximum: Some(Bound::All(1.0)),
            ..FieldSpec::new(name, 1)
        };
        let gripper = FieldSpec { binary: true, ..bounded("gripper") };
        let mut ensemble = Ensemble::new(1, ActionRanges::of(&[bounded("move"), gripper]));
        ensemble.push(0, vec![vec![1.0, -1.0]; 4]).unwrap();
        ensemble.push(1, vec![vec![4.0, -0.3]; 4]).unwrap();
        ensemble.push(2, vec![vec![1.0, 0.4]; 4]).unwrap();
        // The mean of the gripper is negative; the newest prediction opens it.
        assert_eq!(ensemble.action(2), Some(vec![1.0, 1.0]));
    }

    #[test]
    fn under_a_horizon_the_newest_chunk_counts_alone_until_it_is_executed() {
        let chunk = |first: u8| (0..4).map(|i| vec![f32::from(first + i)]).collect::<Vec<_>>();
        let mut ensemble = free(1);
        ensemble.set_execution(Execution::Horizon(2));
        assert_eq!(ensemble.remaining(0), None);
        ensemble.push(0, chunk(10)).unwrap();
        assert_eq!(ensemble.remaining(0), Some(chunk(10).as_slice()));
        assert_eq!(ensemble.remaining(1), Some(&chunk(10)[1..]));
        // Two were executed, so the next chunk is wanted; until it arrives the rest of this one serves.
        assert_eq!((ensemble.remaining(2), ensemble.action(2)), (None, Some(vec![12.0])));
        ensemble.push(2, chunk(50)).unwrap();
        assert_eq!((ensemble.action(2), ensemble.action(3)), (Some(vec![50.0]), Some(vec![51.0])));
        assert_eq!(ensemble.remaining(7), None);
        assert_eq!(Execution::of_horizon(Execution::Horizon(2).horizon()), Execution::Horizon(2));
        assert_eq!(Execution::of_horizon(Execution::Ensembled.horizon()), Execution::Ensembled);
    }

    #[test]
    fn a_rejected_chunk_changes_nothing() {
        let mut ensemble = free(1);
        ensemble.push(3, vec![vec![1.0], vec![2.0]]).unwrap();
        for (time, actions, expected) in [
            (4, vec![], ChunkError::Empty),
            (4, vec![vec![1.0], vec![1.0, 2.0]], ChunkError::Width { index: 1, found: 2, width: 1 }),
            (3, vec![vec![1.0]], ChunkError::Order { last: 3 }),
        ] {
            assert_eq!(ensemble.push(time, actions), Err(expected));
        }
        assert_eq!((ensemble.len(), ensemble.action(4)), (1, Some(vec![2.0])));
        ensemble.clear();
        assert_eq!((ensemble.is_empty(), ensemble.action(4)), (true, None));
    }
}
