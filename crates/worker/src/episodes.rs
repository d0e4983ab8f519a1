//! Episodes in the form of the learning crate: frame caches that are read step by step, and rebuilt where they are missing
//! or damaged, also while the job runs.

use std::{
    ops::Range,
    path::PathBuf,
    sync::{Arc, Mutex, PoisonError},
};

use gleaner_learn::{Numbers, SourceError, StepSource, StepWidths, TaskShape, Trajectory, WeightedSegments};
use gleaner_recording::{FrameCache, Limits, RecordingError, TaskSpec};

use super::failure::Failure;
use gleaner_core::work::{InputEpisode, KeptInput};
use gleaner_data_folder::{blobs::Blobs, caches::note_use, frames_path};

/// Opens the episodes of one task. An open episode takes a few hundred bytes, and no file.
pub(crate) struct Episodes(Arc<Folder>);

/// Where the episodes of one task are.
struct Folder {
    /// The server's data directory.
    data_dir: PathBuf,
    blobs: Blobs,
    task: TaskSpec,
    shape: TaskShape,
    /// One cache is rebuilt at a time.
    rebuilding: Mutex<()>,
}

/// The steps of one episode.
struct Stored {
    folder: Arc<Folder>,
    input: InputEpisode,
    cache: FrameCache,
}

impl Episodes {
    /// The episodes of `task` in a server's data directory with these blobs.
    pub(crate) fn new(data_dir: PathBuf, blobs: Blobs, task: TaskSpec) -> Self {
        let shape = TaskShape::from(&task);
        Self(Arc::new(Folder { data_dir, blobs, task, shape, rebuilding: Mutex::default() }))
    }

    /// The shape of one step.
    pub(crate) fn shape(&self) -> TaskShape {
        self.0.shape.clone()
    }

    /// Every episode, in the order of `inputs`.
    pub(crate) fn trajectories(&self, inputs: &[InputEpisode]) -> Result<Vec<Trajectory>, Failure> {
        inputs.iter().map(|input| self.trajectory(input)).collect()
    }

    /// Every episode with its kept segments and their weights.
    pub(crate) fn weighted(&self, inputs: Vec<KeptInput>) -> Result<Vec<WeightedSegments>, Failure> {
        let weighted = |KeptInput { episode, segments, similarities: _, qualities: _ }| {
            let steps = segments.iter().map(|segment| (segment.end_step, segment.weight)).collect();
            Ok(WeightedSegments { trajectory: self.trajectory(&episode)?, steps })
        };
        inputs.into_iter().map(weighted).collect()
    }

    fn trajectory(&self, input: &InputEpisode) -> Result<Trajectory, Failure> {
        Ok(Trajectory::read_from(&self.0.shape, input.id.as_str(), Arc::new(self.stored(input)?))?)
    }

    fn stored(&self, input: &InputEpisode) -> Result<Stored, Failure> {
        let folder = Arc::clone(&self.0);
        let cache = match folder.open(input) {
            Ok(cache) => cache,
            Err(problem) => {
                folder.rebuild(input, &problem)?;
                folder.open(input).map_err(|error| Failure::recording(input.id.as_str(), &error))?
            }
        };
        if u64::try_from(cache.steps()) != Ok(input.steps) {
            return Err(Failure::Permanent(format!(
                "episode {}: reads as {} steps now, it had {} when it was uploaded; upload it again",
                input.id,
                cache.steps(),
                input.steps
            )));
        }
        Ok(Stored { folder, input: input.clone(), cache })
    }
}

impl Folder {
    fn open(&self, input: &InputEpisode) -> Result<FrameCache, RecordingError> {
        let path = frames_path(&self.data_dir, &input.recording, &self.task);
        note_use(&path);
        FrameCache::open(&path, &self.task)
    }

    fn rebuild(&self, input: &InputEpisode, problem: &RecordingError) -> Result<(), Failure> {
        tracing::info!(episode.id = %input.id, %problem, "rebuilding a frame cache");
        let fault = |error| Failure::recording(input.id.as_str(), &error);
        let recording = self.blobs.path(&input.recording);
        // Compressed pictures take about as much as the recording that they come from, often less.
        self.blobs.make_cache_room(std::fs::metadata(&recording).map_or(0, |file| file.len()))?;
        let cache = frames_path(&self.data_dir, &input.recording, &self.task);
        // The recording was accepted, possibly under wider limits than the present ones.
        gleaner_recording::cache_episode(&recording, &self.task, &Limits::ADMITTED, &cache).map_err(fault)?;
        Ok(())
    }
}

impl Stored {
    /// Reads the cache, again after it was rebuilt if it is gone or damaged.
    fn read<T>(&self, mut read: impl FnMut(&FrameCache) -> Result<T, RecordingError>) -> Result<T, SourceError> {
        match read(&self.cache) {
            Err(error) if error.is_of_the_cache() => {}
            read => return Ok(read?),
        }
        let _one = self.folder.rebuilding.lock().unwrap_or_else(PoisonError::into_inner);
        match read(&self.cache) {
            Err(problem) if problem.is_of_the_cache() => self.folder.rebuild(&self.input, &problem)?,
            // Another thread rebuilt it.
            read => return Ok(read?),
        }
        Ok(read(&self.cache)?)
    }
}

impl StepSource for Stored {
    fn steps(&self) -> usize {
        self.cache.steps()
    }

    fn widths(&self) -> StepWidths {
        StepWidths::from(&self.folder.shape)
    }

    fn numbers(&self, steps: Range<usize>) -> Result<Numbers, SourceError> {
        let numbers = self.read(|cache| cache.numbers(steps.clone()))?;
        Ok(Numbers { proprioception: numbers.proprioception, action: numbers.action })
    }

    fn frames(&self, steps: Range<usize>, frames: &mut [u8]) -> Result<(), SourceError> {
        self.read(|cache| cache.read_frames(steps.clone(), frames))
    }
}

#[cfg(test)]
mod tests;
