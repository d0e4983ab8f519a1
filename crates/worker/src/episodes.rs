//! Episodes in the form of the learning crate: frame caches that are read step by step, and rebuilt where they are missing
//! or damaged, also while the job runs.

use std::{
    io::ErrorKind,
    ops::Range,
    panic::resume_unwind,
    sync::{Arc, Mutex, PoisonError},
    thread::{self, Builder, ScopedJoinHandle},
};

use gleaner_learn::{
    LearnError, Numbers, SourceError, StepSource, StepWidths, TaskShape, Trajectory, WeightedSegments,
};
use gleaner_recording::{FrameCache, ImageThreads, Limits, RecordingError, TaskSpec};

use super::failure::Failure;
use gleaner_core::{
    error::Error,
    work::{InputEpisode, KeptInput},
};
use gleaner_data_folder::{FramePaths, blobs::Blobs, caches::note_use};

/// Threads that open episodes: most of their time they wait for the disk, 0.1 ms for each of 100,000 files.
const OPENING: usize = 8;

/// The most memory of images that are decoded ahead while a cache is rebuilt.
const REBUILDING: usize = 64 << 20;

/// Opens the episodes of one task. An open episode takes a few hundred bytes, and no file.
pub(crate) struct Episodes(Arc<Folder>);

/// Where the episodes of one task are.
struct Folder {
    /// The node folder if there is one, and else the data folder.
    own: Place,
    /// The data folder beside a node folder: its steps are copied, and it is used where the node folder is full.
    shared: Option<Place>,
    task: TaskSpec,
    shape: TaskShape,
    /// One cache is rebuilt at a time.
    rebuilding: Mutex<()>,
}

/// A folder of decoded steps, with the blobs by which they are made.
struct Place {
    paths: FramePaths,
    blobs: Blobs,
}

/// The steps of one episode.
pub(crate) struct Stored {
    folder: Arc<Folder>,
    input: InputEpisode,
    cache: FrameCache,
}

impl Episodes {
    /// The episodes of `task` with the recordings among these blobs.
    pub(crate) fn new(blobs: Blobs, task: TaskSpec) -> Self {
        let place = |blobs: Blobs| Place { paths: FramePaths::new(blobs.steps_folder(), &task), blobs };
        let (shared, own) = (blobs.without_node_folder().map(place), place(blobs));
        let shape = TaskShape::from(&task);
        Self(Arc::new(Folder { own, shared, task, shape, rebuilding: Mutex::default() }))
    }

    /// The shape of one step.
    pub(crate) fn shape(&self) -> TaskShape {
        self.0.shape.clone()
    }

    /// Every episode, in the order of `inputs`.
    pub(crate) fn trajectories(&self, inputs: &[InputEpisode]) -> Result<Vec<Trajectory>, Failure> {
        self.open_all(&inputs.iter().collect::<Vec<_>>())
    }

    /// Every episode with its kept segments and their weights.
    pub(crate) fn weighted(&self, inputs: Vec<KeptInput>) -> Result<Vec<WeightedSegments>, Failure> {
        let trajectories = self.open_all(&inputs.iter().map(|kept| &kept.episode).collect::<Vec<_>>())?;
        let weighted = |(trajectory, KeptInput { segments, .. }): (Trajectory, KeptInput)| {
            let steps = segments.iter().map(|segment| (segment.end_step, segment.weight)).collect();
            WeightedSegments { trajectory, steps }
        };
        Ok(trajectories.into_iter().zip(inputs).map(weighted).collect())
    }

    /// Every episode, in the order of `inputs`; the error of the first one that cannot be opened.
    fn open_all(&self, inputs: &[&InputEpisode]) -> Result<Vec<Trajectory>, Failure> {
        let open = |inputs: &[&InputEpisode]| -> Result<Vec<_>, _> {
            inputs.iter().map(|input| self.trajectory(input)).collect()
        };
        let parts = thread::scope(|scope| {
            let begin = |part| Builder::new().name("episodes".to_owned()).spawn_scoped(scope, move || open(part));
            let running = inputs.chunks(inputs.len().div_ceil(OPENING).max(1)).map(begin);
            let running: Vec<_> = running.collect::<Result<_, _>>().map_err(LearnError::Thread)?;
            let ended = |part: ScopedJoinHandle<'_, _>| part.join().unwrap_or_else(|panic| resume_unwind(panic));
            running.into_iter().map(ended).collect::<Result<Vec<_>, Failure>>()
        })?;
        Ok(parts.into_iter().flatten().collect())
    }

    fn trajectory(&self, input: &InputEpisode) -> Result<Trajectory, Failure> {
        Ok(Trajectory::read_from(&self.0.shape, input.id.as_str(), Arc::new(self.stored(input)?))?)
    }

    /// One episode.
    pub(crate) fn stored(&self, input: &InputEpisode) -> Result<Stored, Failure> {
        let folder = Arc::clone(&self.0);
        folder.take_shared(input);
        let cache = match folder.open(input) {
            Ok(cache) => cache,
            Err(problem) => {
                let _one = folder.rebuilding.lock().unwrap_or_else(PoisonError::into_inner);
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
    /// The file of an episode, of the first place that has one; else the error of the last.
    fn open(&self, input: &InputEpisode) -> Result<FrameCache, RecordingError> {
        let open = |place: &Place| {
            let path = place.paths.of(&input.recording);
            note_use(&path);
            FrameCache::open(&path, &self.task)
        };
        match (open(&self.own), &self.shared) {
            (Err(_), Some(shared)) => open(shared),
            (opened, _) => opened,
        }
    }

    /// Copies the server's steps of an episode to the node folder, if that has none.
    fn take_shared(&self, input: &InputEpisode) {
        let Some(shared) = &self.shared else { return };
        let (from, to) = (shared.paths.of(&input.recording), self.own.paths.of(&input.recording));
        if to.exists() {
            return;
        }
        if let Err(error) = self.own.blobs.copy_steps(&from, &to) {
            tracing::warn!(episode.id = %input.id, %error, "steps were not copied to the node folder");
        }
    }

    fn rebuild(&self, input: &InputEpisode, problem: &RecordingError) -> Result<(), Failure> {
        tracing::info!(episode.id = %input.id, %problem, "rebuilding a frame cache");
        // An error of the store is that of every place.
        let unusable = |error: Error| Failure::from(error).of_episode(input.id.as_str());
        let _recording = self.own.blobs.fetched(&input.recording).map_err(unusable)?;
        match (self.write_cache(&self.own, input), &self.shared) {
            (Err(Failure::Retryable(error)), Some(shared)) => {
                tracing::warn!(episode.id = %input.id, %error, "steps are made in the data folder");
                self.write_cache(shared, input)
            }
            (written, _) => written,
        }
    }

    /// Writes the cache of an episode.
    fn write_cache(&self, place: &Place, input: &InputEpisode) -> Result<(), Failure> {
        let fault = |error| Failure::recording(input.id.as_str(), &error);
        match self.write_once(place, input)? {
            Ok(()) => Ok(()),
            Err(error) if found_full(&error) => match place.blobs.evict_steps(self.most_written(input))? {
                true => self.write_once(place, input)?.map_err(fault),
                false => Err(fault(error)),
            },
            // The recording was sound when it was stored. The copy of one in a bucket may be damaged since.
            Err(_) if place.blobs.drop_damaged_copy(&input.recording).unwrap_or(false) => {
                self.write_once(place, input)?.map_err(fault)
            }
            Err(error) => Err(fault(error)),
        }
    }

    /// The largest file of an episode's steps.
    fn most_written(&self, input: &InputEpisode) -> u64 {
        input.steps.saturating_mul(StepWidths::from(&self.shape).frame_bytes as u64)
    }

    /// Writes the cache of an episode. The inner error is the recording's.
    fn write_once(&self, place: &Place, input: &InputEpisode) -> Result<Result<(), RecordingError>, Failure> {
        let recording = place.blobs.fetched(&input.recording)?;
        // Compressed pictures take about as much as the recording that they come from, often less.
        let expected = std::fs::metadata(&recording).map_or(0, |file| file.len());
        place.blobs.make_cache_room(expected)?;
        let cache = place.paths.of(&input.recording);
        // The recording was accepted, possibly under wider limits than the present ones.
        let count = thread::available_parallelism().map_or(1, |processors| processors.get().min(OPENING));
        let threads = ImageThreads { count, bytes: REBUILDING };
        let limits = (&Limits::ADMITTED, threads);
        let written = gleaner_recording::cache_episode(&recording, &self.task, limits, &cache);
        if written.is_ok() {
            place.blobs.count_cache(&cache, expected)?;
        }
        Ok(written.map(drop))
    }
}

/// Whether the disk was full.
fn found_full(error: &RecordingError) -> bool {
    let full = |kind| matches!(kind, ErrorKind::StorageFull | ErrorKind::QuotaExceeded);
    matches!(error, RecordingError::Io { source, .. } if full(source.kind()))
}

impl Stored {
    /// Reads the cache, again after it was rebuilt if it is gone or damaged.
    fn read<T>(&self, mut read: impl FnMut(&FrameCache) -> Result<T, RecordingError>) -> Result<T, SourceError> {
        match read(&self.cache) {
            Err(error) if error.is_of_the_cache() => {}
            read => return Ok(read?),
        }
        let _one = self.folder.rebuilding.lock().unwrap_or_else(PoisonError::into_inner);
        // Another thread may have rebuilt it, or the data folder may have it.
        match self.folder.open(&self.input).and_then(|cache| read(&cache)) {
            Err(problem) if problem.is_of_the_cache() => self.folder.rebuild(&self.input, &problem)?,
            read => return Ok(read?),
        }
        Ok(read(&self.folder.open(&self.input)?)?)
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
