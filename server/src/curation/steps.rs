//! The steps of one episode, mapped, by index.

use gleaner_recording::{Episode as Decoded, FieldSpec, TaskSpec};

use super::picture::picture;
use crate::{
    domain::{
        id::EpisodeId,
        steps::{FrameView, Numbers, Series},
    },
    error::{Error, Result},
};

/// An episode's steps and their labels.
pub(super) struct Steps {
    episode: EpisodeId,
    spec: TaskSpec,
    decoded: Decoded,
}

impl Steps {
    pub(super) fn new(episode: EpisodeId, spec: TaskSpec, decoded: Decoded) -> Self {
        Self { episode, spec, decoded }
    }

    /// One step of a camera, as JPEG. Reads the disk.
    pub(super) fn frame(&self, view: &FrameView) -> Result<Vec<u8>> {
        let steps = self.decoded.steps();
        let missing = || {
            let range = format!("{} of {}; it has {steps} steps, counted from 0", view.step, self.episode);
            Error::not_found("step", range)
        };
        let step = usize::try_from(view.step).ok().filter(|&step| step < steps).ok_or_else(missing)?;
        let frames = self.decoded.frames();
        let per_step = frames.as_ref().len() / steps;
        let frame = frames.as_ref().get(step * per_step..(step + 1) * per_step).ok_or_else(missing)?;
        picture(&self.spec, frame, view)
    }

    pub(super) fn numbers(&self) -> Numbers {
        Numbers {
            stamps_ns: self.decoded.stamps().to_vec(),
            proprioception: series(&self.spec.proprioception, &self.decoded.proprioception()),
            action: series(&self.spec.action, &self.decoded.action()),
        }
    }
}

/// Row-major values, T × all fields, by field.
fn series(fields: &[FieldSpec], values: &[f32]) -> Vec<Series> {
    let width: usize = fields.iter().map(|field| field.size as usize).sum();
    let mut from = 0;
    let one = |field: &FieldSpec| {
        let size = field.size as usize;
        let range = from..from + size;
        from += size;
        let values = values.chunks_exact(width.max(1)).flat_map(|row| row[range.clone()].iter().copied());
        Series { name: field.name.clone(), size, values: values.collect() }
    };
    fields.iter().map(one).collect()
}
