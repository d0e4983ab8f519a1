//! Steps of recordings in the form of the learning crate, read from their frame caches when they are used.

use std::ops::Range;

use gleaner_learn::{Numbers, SourceError, StepSource, StepWidths};
use gleaner_recording::{FrameCache, Numbers as Rows};
use tokio::runtime::Handle;

use crate::ingest::Frames;

/// The steps of a recording that is not stored.
pub(super) struct Unstored {
    pub(super) steps: FrameCache,
    pub(super) widths: StepWidths,
}

/// The steps of a stored recording, whose cache is rebuilt where it is missing. Only threads outside of the runtime may
/// read them.
pub(super) struct Stored {
    pub(super) steps: Frames,
    pub(super) widths: StepWidths,
    pub(super) runtime: Handle,
}

impl StepSource for Unstored {
    fn steps(&self) -> usize {
        self.steps.steps()
    }

    fn widths(&self) -> StepWidths {
        self.widths
    }

    fn numbers(&self, steps: Range<usize>) -> Result<Numbers, SourceError> {
        Ok(numbers(self.steps.numbers(steps)?))
    }

    fn frames(&self, steps: Range<usize>, frames: &mut [u8]) -> Result<(), SourceError> {
        Ok(self.steps.read_frames(steps, frames)?)
    }
}

impl StepSource for Stored {
    fn steps(&self) -> usize {
        self.steps.steps()
    }

    fn widths(&self) -> StepWidths {
        self.widths
    }

    fn numbers(&self, steps: Range<usize>) -> Result<Numbers, SourceError> {
        Ok(numbers(self.runtime.block_on(self.steps.numbers(steps))?))
    }

    fn frames(&self, steps: Range<usize>, frames: &mut [u8]) -> Result<(), SourceError> {
        let read = self.runtime.block_on(self.steps.images(steps))?;
        if read.len() != frames.len() {
            return Err(format!("its steps have {} bytes of images instead of {}", read.len(), frames.len()).into());
        }
        frames.copy_from_slice(&read);
        Ok(())
    }
}

fn numbers(Rows { stamps: _, proprioception, action }: Rows) -> Numbers {
    Numbers { proprioception, action }
}
