//! Episodes in the form of the learning crate: frame caches, rebuilt where they are missing or damaged.

use std::{path::PathBuf, sync::Arc};

use gleaner_learn::{TaskShape, Trajectory, WeightedSegments};
use gleaner_recording::{FrameCache, Limits, TaskSpec};

use super::failure::Failure;
use gleaner_core::work::{InputEpisode, KeptInput};
use gleaner_data_folder::{blobs::Blobs, frames_path};

/// Opens the episodes of one task.
pub(crate) struct Episodes<'a> {
    /// The server's data directory.
    pub(crate) data_dir: &'a PathBuf,
    /// Its blobs.
    pub(crate) blobs: &'a Blobs,
    /// The task's spec.
    pub(crate) task: &'a TaskSpec,
}

impl Episodes<'_> {
    /// The shape of one step.
    pub(crate) fn shape(&self) -> TaskShape {
        self.task.into()
    }

    /// Every episode, in the order of `inputs`.
    pub(crate) fn trajectories(&self, inputs: &[InputEpisode]) -> Result<Vec<Trajectory>, Failure> {
        let shape = self.shape();
        inputs.iter().map(|input| self.trajectory(&shape, input)).collect()
    }

    /// Every episode with its kept segments and their weights.
    pub(crate) fn weighted(&self, inputs: Vec<KeptInput>) -> Result<Vec<WeightedSegments>, Failure> {
        let shape = self.shape();
        let weighted = |KeptInput { episode, segments, similarities: _, qualities: _ }| {
            let steps = segments.iter().map(|segment| (segment.end_step, segment.weight)).collect();
            Ok(WeightedSegments { trajectory: self.trajectory(&shape, &episode)?, steps })
        };
        inputs.into_iter().map(weighted).collect()
    }

    fn trajectory(&self, shape: &TaskShape, input: &InputEpisode) -> Result<Trajectory, Failure> {
        let episode = self.open(input)?;
        if u64::try_from(episode.steps()) != Ok(input.steps) {
            return Err(Failure::Permanent(format!(
                "episode {}: reads as {} steps now, it had {} when it was uploaded; upload it again",
                input.id,
                episode.steps(),
                input.steps
            )));
        }
        let fault = |error| Failure::recording(input.id.as_str(), &error);
        let numbers = episode.numbers(0..episode.steps()).map_err(fault)?;
        let frames = episode.frames(0..episode.steps()).map_err(fault)?;
        Ok(Trajectory::new(shape, input.id.as_str(), Arc::new(frames), numbers.proprioception, numbers.action)?)
    }

    fn open(&self, input: &InputEpisode) -> Result<FrameCache, Failure> {
        let cache = frames_path(self.data_dir, &input.recording, self.task);
        let problem = match FrameCache::open(&cache, self.task) {
            Ok(episode) => return Ok(episode),
            Err(error) => error,
        };
        tracing::info!(episode.id = %input.id, %problem, "rebuilding a frame cache");
        let fault = |error| Failure::recording(input.id.as_str(), &error);
        let recording = self.blobs.path(&input.recording);
        // Compressed pictures take about as much as the recording that they come from, often less.
        self.blobs.make_cache_room(std::fs::metadata(&recording).map_or(0, |file| file.len()))?;
        // The recording was accepted, possibly under wider limits than the present ones.
        gleaner_recording::cache_episode(&recording, self.task, &Limits::ADMITTED, &cache).map_err(fault)?;
        FrameCache::open(&cache, self.task).map_err(fault)
    }
}
