//! Episodes as plain arrays, the input of every stage. Independent of recordings and tensors.

use std::fmt;
use std::sync::Arc;

use crate::error::LearnError;
use crate::shape::TaskShape;

/// Images of all steps of one episode in sequence; a vector or a mapped file.
///
/// Per step and per camera in the shape's order: `H*W*3` bytes of RGB, then, if the camera has
/// depth, `H*W` little-endian `u16` of millimetres with 0 for "no reading".
pub type FrameBytes = Arc<dyn AsRef<[u8]> + Send + Sync>;

/// One episode of T aligned steps.
#[derive(Clone)]
pub struct Trajectory {
    /// The episode's id, for messages and for "an episode never matches itself".
    pub id: String,
    /// The images, `T * frame_bytes` bytes.
    pub frames: FrameBytes,
    /// Proprioception, `T * M` values, step by step, in physical units.
    pub proprioception: Vec<f32>,
    /// Actions, `T * A` values, step by step, in physical units.
    pub action: Vec<f32>,
}

impl fmt::Debug for Trajectory {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Trajectory")
            .field("id", &self.id)
            .field("frame_bytes", &self.frames.as_ref().as_ref().len())
            .field("proprioception", &self.proprioception.len())
            .field("action", &self.action.len())
            .finish()
    }
}

impl Trajectory {
    /// Builds an episode and checks it against `shape`.
    ///
    /// # Errors
    /// [`LearnError::Invalid`] if lengths do not agree on the number of steps, there is no step,
    /// or a value is not finite.
    pub fn new(
        shape: &TaskShape,
        id: impl Into<String>,
        frames: FrameBytes,
        proprioception: Vec<f32>,
        action: Vec<f32>,
    ) -> Result<Self, LearnError> {
        let trajectory = Self { id: id.into(), frames, proprioception, action };
        trajectory.validate(shape)?;
        Ok(trajectory)
    }

    /// Number of steps T under `shape`.
    pub fn steps(&self, shape: &TaskShape) -> usize {
        self.action.len() / shape.action.max(1)
    }

    /// A hash of the steps, whatever the episode's id and the file that it was read from.
    pub(crate) fn content(&self) -> blake3::Hash {
        let mut hasher = blake3::Hasher::new();
        hasher.update(self.frames.as_ref().as_ref());
        for value in self.proprioception.iter().chain(&self.action) {
            hasher.update(&value.to_le_bytes());
        }
        hasher.finalize()
    }

    /// The images of `step`.
    pub(crate) fn frame(&self, shape: &TaskShape, step: usize) -> &[u8] {
        let size = shape.frame_bytes();
        &self.frames.as_ref().as_ref()[step * size..(step + 1) * size]
    }

    /// Proprioception m_t of `step`.
    pub(crate) fn proprioception_at(&self, shape: &TaskShape, step: usize) -> &[f32] {
        &self.proprioception[step * shape.proprioception..(step + 1) * shape.proprioception]
    }

    /// Action a_t of `step`.
    pub(crate) fn action_at(&self, shape: &TaskShape, step: usize) -> &[f32] {
        &self.action[step * shape.action..(step + 1) * shape.action]
    }

    /// Checks lengths and values against `shape`, which must itself be valid.
    pub(crate) fn validate(&self, shape: &TaskShape) -> Result<(), LearnError> {
        let steps = self.steps(shape);
        if steps == 0 {
            return Err(self.invalid("action", "has no step; leave the episode out"));
        }
        self.expect_length("action", self.action.len(), steps * shape.action)?;
        self.expect_length("proprioception", self.proprioception.len(), steps * shape.proprioception)?;
        let bytes = self.frames.as_ref().as_ref().len();
        self.expect_length("frames", bytes, steps * shape.frame_bytes())?;
        self.expect_finite("action", &self.action, shape.action)?;
        self.expect_finite("proprioception", &self.proprioception, shape.proprioception)
    }

    fn expect_length(&self, field: &str, found: usize, expected: usize) -> Result<(), LearnError> {
        if found == expected {
            return Ok(());
        }
        Err(self.invalid(
            field,
            &format!("has length {found}, the number of steps and the task's shape ask for {expected}"),
        ))
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
        let steps = self.trajectory.steps(shape);
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
mod tests {
    use super::*;
    use crate::shape::CameraShape;

    fn shape() -> TaskShape {
        TaskShape {
            cameras: vec![CameraShape { name: "top".into(), height: 8, width: 8, depth: true, recorded: None }],
            proprioception: 2,
            action: 1,
            ranges: gleaner_core::action::ActionRanges::default(),
        }
    }

    fn build(frames: usize, proprioception: Vec<f32>, action: Vec<f32>) -> Result<Trajectory, LearnError> {
        let bytes: FrameBytes = Arc::new(vec![0u8; frames]);
        Trajectory::new(&shape(), "ep", bytes, proprioception, action)
    }

    #[test]
    fn lengths_must_agree_on_the_number_of_steps() {
        assert_eq!(build(640, vec![0.0; 4], vec![0.0; 2]).unwrap().steps(&shape()), 2);
        for (bad, field) in [
            (build(639, vec![0.0; 4], vec![0.0; 2]), "frames"),
            (build(640, vec![0.0; 3], vec![0.0; 2]), "proprioception"),
            (build(0, vec![], vec![]), "action"),
        ] {
            let message = bad.unwrap_err().to_string();
            assert!(message.starts_with(&format!("episode ep: {field}")), "{message}");
        }
    }

    #[test]
    fn a_value_that_is_not_finite_is_placed() {
        let error = build(640, vec![0.0, 0.0, 0.0, f32::NAN], vec![0.0; 2]).unwrap_err();
        assert!(error.to_string().contains("dimension 1 of step 1"), "{error}");
    }
}
