//! The steps of one episode by index, read from its frame cache.

use gleaner_recording::{FieldSpec, TaskSpec};

use super::{off_runtime, picture::picture};
use crate::{
    domain::{
        id::EpisodeId,
        steps::{FrameView, Numbers, Series},
    },
    error::{Error, Result},
    ingest::Frames,
};

/// An episode's steps and their labels.
pub(super) struct Steps {
    episode: EpisodeId,
    spec: TaskSpec,
    frames: Frames,
}

impl Steps {
    pub(super) fn new(episode: EpisodeId, spec: TaskSpec, frames: Frames) -> Self {
        Self { episode, spec, frames }
    }

    /// One step of a camera, as JPEG.
    pub(super) async fn frame(&self, view: FrameView) -> Result<Vec<u8>> {
        let steps = self.frames.steps();
        let missing = || {
            let range = format!("{} of {}; it has {steps} steps, counted from 0", view.step, self.episode);
            Error::not_found("step", range)
        };
        let step = usize::try_from(view.step).ok().filter(|&step| step < steps).ok_or_else(missing)?;
        let (frame, spec) = (self.frames.images(step..step + 1).await?, self.spec.clone());
        off_runtime("drawing a frame", move || picture(&spec, &frame, &view)).await
    }

    /// The numbers of every step.
    pub(super) async fn numbers(&self) -> Result<Numbers> {
        let numbers = self.frames.numbers(0..self.frames.steps()).await?;
        Ok(Numbers {
            proprioception: series(&self.spec.proprioception, &numbers.proprioception),
            action: series(&self.spec.action, &numbers.action),
            stamps_ns: numbers.stamps,
        })
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
