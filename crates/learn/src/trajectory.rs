//! Episodes, the input of every stage. Independent of recordings and tensors.

use std::fmt;
use std::ops::Range;
use std::sync::Arc;

use crate::error::{LearnError, SourceError};
use crate::shape::TaskShape;
use crate::steps::{Arrays, Numbers, StepSource, StepWidths, WithActions};

/// Steps whose images are in memory at once while an episode is hashed.
const HASHED_STEPS: usize = 16;

/// One episode of T aligned steps, which are read when they are used. Cheap to clone.
#[derive(Clone)]
pub struct Trajectory {
    /// The episode's id, for messages and for "an episode never matches itself".
    pub id: String,
    pub(crate) source: Arc<dyn StepSource>,
}

impl fmt::Debug for Trajectory {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (steps, widths) = (self.source.steps(), self.source.widths());
        f.debug_struct("Trajectory").field("id", &self.id).field("steps", &steps).field("widths", &widths).finish()
    }
}

impl Trajectory {
    /// Builds an episode in memory and checks it against `shape`: `T * frame_bytes` bytes of images, `T * M` values of
    /// proprioception and `T * A` of actions, step by step, in physical units.
    ///
    /// # Errors
    /// [`LearnError::Invalid`] if lengths do not agree on the number of steps, there is no step,
    /// or a value is not finite.
    pub fn new(
        shape: &TaskShape,
        id: impl Into<String>,
        frames: Vec<u8>,
        proprioception: Vec<f32>,
        action: Vec<f32>,
    ) -> Result<Self, LearnError> {
        let arrays = Arrays { widths: shape.into(), frames, proprioception, action };
        let trajectory = Self { id: id.into(), source: Arc::new(arrays.clone()) };
        trajectory.validate(shape)?;
        let steps = trajectory.steps();
        let Arrays { widths, frames, proprioception, action } = &arrays;
        for (field, found, width) in [
            ("action", action.len(), widths.action),
            ("proprioception", proprioception.len(), widths.proprioception),
            ("frames", frames.len(), widths.frame_bytes),
        ] {
            if found != steps * width {
                let expected = steps * width;
                return Err(trajectory.invalid(
                    field,
                    &format!("has length {found}, the number of steps and the task's shape ask for {expected}"),
                ));
            }
        }
        trajectory.expect_finite("action", action, widths.action)?;
        trajectory.expect_finite("proprioception", proprioception, widths.proprioception)?;
        Ok(trajectory)
    }

    /// An episode whose steps are read from `source` when they are used. Its values must be finite.
    ///
    /// # Errors
    /// [`LearnError::Invalid`] if there is no step, or a step's size is not that of `shape`.
    pub fn read_from(
        shape: &TaskShape,
        id: impl Into<String>,
        source: Arc<dyn StepSource>,
    ) -> Result<Self, LearnError> {
        let trajectory = Self { id: id.into(), source };
        trajectory.validate(shape)?;
        Ok(trajectory)
    }

    /// Number of steps T.
    pub fn steps(&self) -> usize {
        self.source.steps()
    }

    /// The numbers of these steps.
    pub(crate) fn numbers(&self, steps: Range<usize>) -> Result<Numbers, LearnError> {
        self.source.numbers(steps).map_err(|error| self.unreadable(error))
    }

    /// The actions of all steps, `T * A`.
    pub(crate) fn actions(&self) -> Result<Vec<f32>, LearnError> {
        Ok(self.numbers(0..self.steps())?.action)
    }

    /// Fills `frames` with the images of these steps.
    pub(crate) fn read_frames(&self, steps: Range<usize>, frames: &mut [u8]) -> Result<(), LearnError> {
        self.source.frames(steps, frames).map_err(|error| self.unreadable(error))
    }

    /// The same episode with other actions, `T * A`.
    pub(crate) fn with_actions(&self, action: Vec<f32>) -> Self {
        let source = Arc::new(WithActions { steps: Arc::clone(&self.source), action });
        Self { id: self.id.clone(), source }
    }

    /// A hash of the steps, whatever the episode's id and where they are read from.
    pub(crate) fn content(&self) -> Result<blake3::Hash, LearnError> {
        let (mut hasher, size) = (blake3::Hasher::new(), self.source.widths().frame_bytes);
        let mut frames = vec![0; HASHED_STEPS.min(self.steps()) * size];
        for begin in (0..self.steps()).step_by(HASHED_STEPS) {
            let steps = begin..self.steps().min(begin + HASHED_STEPS);
            let frames = &mut frames[..steps.len() * size];
            self.read_frames(steps, frames)?;
            hasher.update(frames);
        }
        let Numbers { proprioception, action } = self.numbers(0..self.steps())?;
        for value in proprioception.iter().chain(&action) {
            hasher.update(&value.to_le_bytes());
        }
        Ok(hasher.finalize())
    }

    /// Checks the size of a step against `shape`, which must itself be valid.
    pub(crate) fn validate(&self, shape: &TaskShape) -> Result<(), LearnError> {
        let (found, expected) = (self.source.widths(), StepWidths::from(shape));
        if self.steps() == 0 {
            return Err(self.invalid("action", "has no step; leave the episode out"));
        }
        for (field, found, expected) in [
            ("action", found.action, expected.action),
            ("proprioception", found.proprioception, expected.proprioception),
            ("frames", found.frame_bytes, expected.frame_bytes),
        ] {
            if found != expected {
                return Err(self.invalid(field, &format!("has {found} a step, the task's shape asks for {expected}")));
            }
        }
        Ok(())
    }

    fn expect_finite(&self, field: &str, values: &[f32], width: usize) -> Result<(), LearnError> {
        match values.iter().position(|value| !value.is_finite()) {
            None => Ok(()),
            Some(at) => Err(self.invalid(
                field,
                &format!(
                    "dimension {} of step {} is not finite; correct the step or leave it out",
                    at % width,
                    at / width
                ),
            )),
        }
    }

    fn invalid(&self, field: &str, message: &str) -> LearnError {
        LearnError::invalid(format!("episode {}: {field}", self.id), message)
    }

    fn unreadable(&self, source: SourceError) -> LearnError {
        LearnError::Steps { episode: self.id.clone(), source }
    }
}

/// What tests read and change.
#[cfg(test)]
impl Trajectory {
    /// Everything that the episode has.
    pub(crate) fn arrays(&self) -> Arrays {
        let (widths, steps) = (self.source.widths(), 0..self.steps());
        let Numbers { proprioception, action } = self.source.numbers(steps.clone()).unwrap();
        let mut frames = vec![0; steps.len() * widths.frame_bytes];
        self.source.frames(steps, &mut frames).unwrap();
        Arrays { widths, frames, proprioception, action }
    }

    /// The same episode in memory after a change of its arrays.
    pub(crate) fn changed(&self, change: impl FnOnce(&mut Arrays)) -> Self {
        let mut arrays = self.arrays();
        change(&mut arrays);
        Self { id: self.id.clone(), source: Arc::new(arrays) }
    }

    /// The images of `step`.
    pub(crate) fn frame(&self, step: usize) -> Vec<u8> {
        let mut frame = vec![0; self.source.widths().frame_bytes];
        self.source.frames(step..step + 1, &mut frame).unwrap();
        frame
    }
}

/// The kept segments of one imperfect episode.
#[derive(Debug, Clone)]
pub struct WeightedSegments {
    /// The episode.
    pub trajectory: Trajectory,
    /// (the step the segment ends at, its weight q in 0 … 1), in any order.
    pub steps: Vec<(u32, f32)>,
}

impl WeightedSegments {
    pub(crate) fn validate(&self, shape: &TaskShape) -> Result<(), LearnError> {
        self.trajectory.validate(shape)?;
        let steps = self.trajectory.steps();
        for (step, weight) in &self.steps {
            if *step as usize >= steps {
                return Err(self
                    .trajectory
                    .invalid("kept segments", &format!("end at step {step}, the episode has {steps} steps")));
            }
            if !(0.0..=1.0).contains(weight) {
                return Err(self
                    .trajectory
                    .invalid("kept segments", &format!("weight {weight} at step {step} is not between 0 and 1")));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
