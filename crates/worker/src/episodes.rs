//! Episodes in the form of the learning crate: mapped frame caches, rebuilt where they are missing or damaged.

use std::{path::PathBuf, sync::Arc};

use gleaner_learn::{TaskShape, Trajectory, WeightedSegments};
use gleaner_recording::{Episode, Limits, TaskSpec, frame_bytes_per_step};

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
        let (proprioception, action) = (episode.proprioception(), episode.action());
        Ok(Trajectory::new(shape, input.id.as_str(), Arc::new(episode.frames()), proprioception, action)?)
    }

    fn open(&self, input: &InputEpisode) -> Result<Episode, Failure> {
        let cache = frames_path(self.data_dir, &input.recording, self.task);
        let problem = match Episode::open(&cache) {
            Ok(episode) => return Ok(episode),
            Err(error) => error,
        };
        tracing::info!(episode.id = %input.id, %problem, "rebuilding a frame cache");
        let frames = u64::try_from(frame_bytes_per_step(self.task)).unwrap_or(u64::MAX);
        self.blobs.make_cache_room(frames.saturating_mul(input.steps))?;
        let fault = |error| Failure::recording(input.id.as_str(), &error);
        let recording = self.blobs.path(&input.recording);
        // The recording was accepted, possibly under wider limits than the present ones.
        let reading =
            gleaner_recording::read_episode_within(&recording, self.task, &Limits::ADMITTED).map_err(fault)?;
        // The mapped cache needs no memory of the process; the decoded frames are dropped.
        reading.episode.write_cache(&cache).map_err(fault)?;
        Episode::open(&cache).map_err(fault)
    }
}
