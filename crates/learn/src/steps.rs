//! Where the steps of an episode are read from: memory, or whatever the caller implements [`StepSource`] for.
//! Independent of tensors.

use std::ops::Range;
use std::sync::Arc;

use crate::error::SourceError;
use crate::shape::TaskShape;

/// The T steps of one episode. Each method may be called by several threads at once, and returns the same for the same
/// steps as long as a job runs.
///
/// A step's images are, for each camera in the shape's order, `H*W*3` bytes of RGB, then, if the camera has depth,
/// `H*W` little-endian `u16` of millimetres with 0 for "no reading".
pub trait StepSource: Send + Sync {
    /// Number of steps T.
    fn steps(&self) -> usize;

    /// The size of each step.
    fn widths(&self) -> StepWidths;

    /// The numbers of these steps.
    ///
    /// # Errors
    /// The reason why they could not be read.
    fn numbers(&self, steps: Range<usize>) -> Result<Numbers, SourceError>;

    /// Fills `frames` with the images of these steps, one step after the other; it has their size.
    ///
    /// # Errors
    /// The reason why they could not be read.
    fn frames(&self, steps: Range<usize>, frames: &mut [u8]) -> Result<(), SourceError>;
}

/// The size of a step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StepWidths {
    /// Bytes of the images.
    pub frame_bytes: usize,
    /// Values of proprioception M.
    pub proprioception: usize,
    /// Values of the action A.
    pub action: usize,
}

/// The numbers of consecutive steps, step by step, in physical units.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Numbers {
    /// Steps × M values.
    pub proprioception: Vec<f32>,
    /// Steps × A values.
    pub action: Vec<f32>,
}

impl From<&TaskShape> for StepWidths {
    fn from(shape: &TaskShape) -> Self {
        Self { frame_bytes: shape.frame_bytes(), proprioception: shape.proprioception, action: shape.action }
    }
}

/// Steps in memory.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Arrays {
    pub(crate) widths: StepWidths,
    /// `T * frame_bytes` bytes.
    pub(crate) frames: Vec<u8>,
    /// `T * M` values.
    pub(crate) proprioception: Vec<f32>,
    /// `T * A` values.
    pub(crate) action: Vec<f32>,
}

impl StepSource for Arrays {
    fn steps(&self) -> usize {
        self.action.len() / self.widths.action.max(1)
    }

    fn widths(&self) -> StepWidths {
        self.widths
    }

    fn numbers(&self, steps: Range<usize>) -> Result<Numbers, SourceError> {
        let proprioception = part(&self.proprioception, &steps, self.widths.proprioception)?.to_vec();
        Ok(Numbers { proprioception, action: part(&self.action, &steps, self.widths.action)?.to_vec() })
    }

    fn frames(&self, steps: Range<usize>, frames: &mut [u8]) -> Result<(), SourceError> {
        frames.copy_from_slice(part(&self.frames, &steps, self.widths.frame_bytes)?);
        Ok(())
    }
}

/// The steps of another source with other actions.
pub(crate) struct WithActions {
    pub(crate) steps: Arc<dyn StepSource>,
    /// `T * A` values.
    pub(crate) action: Vec<f32>,
}

impl StepSource for WithActions {
    fn steps(&self) -> usize {
        self.steps.steps()
    }

    fn widths(&self) -> StepWidths {
        self.steps.widths()
    }

    fn numbers(&self, steps: Range<usize>) -> Result<Numbers, SourceError> {
        let action = part(&self.action, &steps, self.widths().action)?.to_vec();
        Ok(Numbers { action, ..self.steps.numbers(steps)? })
    }

    fn frames(&self, steps: Range<usize>, frames: &mut [u8]) -> Result<(), SourceError> {
        self.steps.frames(steps, frames)
    }
}

/// The values of some steps.
fn part<'a, T>(all: &'a [T], steps: &Range<usize>, width: usize) -> Result<&'a [T], SourceError> {
    let beyond = || format!("steps {steps:?} are beyond the end");
    Ok(all.get(steps.start * width..steps.end * width).ok_or_else(beyond)?)
}
