//! The steps of some attempts of an evaluation, from which it reports what the policy looked at. Must not depend on the
//! simulator's tasks.

use gleaner_learn::{LearnError, TaskShape, Trajectory};
use gleaner_sim::Observation;

/// Attempts whose steps are kept, the first of an evaluation's first block. Steps of the same attempt are alike, so that more attempts
/// say more than more steps.
pub(super) const ATTEMPTS: usize = 24;
/// Bytes of images kept of an attempt; its further steps are left out.
const MAX_BYTES: usize = 4 << 20;

/// The steps of an attempt so far.
#[derive(Default)]
pub(super) struct Steps {
    frames: Vec<u8>,
    proprioception: Vec<f32>,
    action: Vec<f32>,
}

impl Steps {
    /// Adds an observation and the action that was executed after it.
    pub(super) fn add(&mut self, observation: &Observation, action: &[f32]) {
        if self.frames.len() + observation.frames.len() <= MAX_BYTES {
            self.frames.extend_from_slice(&observation.frames);
            self.proprioception.extend_from_slice(&observation.proprioception);
            self.action.extend_from_slice(action);
        }
    }

    /// The steps as an episode; `None` if an image is larger than all that is kept.
    pub(super) fn episode(self, shape: &TaskShape, attempt: usize) -> Result<Option<Trajectory>, LearnError> {
        if self.action.is_empty() {
            return Ok(None);
        }
        let id = format!("attempt {attempt}");
        Ok(Some(Trajectory::new(shape, id, self.frames, self.proprioception, self.action)?))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_attempt_keeps_its_first_steps_up_to_the_limit() {
        let mut steps = Steps::default();
        let observation = |bytes| Observation { frames: vec![0; bytes], proprioception: vec![1.0], stamp_ns: 0 };
        steps.add(&observation(MAX_BYTES), &[0.5]);
        steps.add(&observation(1), &[0.5]);
        assert_eq!((steps.frames.len(), steps.action.len()), (MAX_BYTES, 1));
        let mut none = Steps::default();
        none.add(&observation(MAX_BYTES + 1), &[0.5]);
        assert!(none.action.is_empty() && none.proprioception.is_empty());
    }
}
