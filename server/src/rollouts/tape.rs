//! The file of one running session. Blocking code; whoever uses it does so away from the runtime.

use std::{
    collections::BTreeMap,
    fs::File,
    io::BufWriter,
    time::{Duration, Instant},
};

use gleaner_recording::{CameraRef, EpisodeWriter, ImageRef, ObservationRef, PixelFormat, RecordingError, TaskSpec};

use super::{
    about::{Place, Slip, fault},
    event::{Ending, Note, Written},
};
use crate::{
    blobs::sync_folder,
    domain::observation::{CameraFrame, Image, ImageFormat},
    error::{Error, Result},
};

/// A crash loses what came after the last sync: at most this.
const SYNC_AFTER: Duration = Duration::from_secs(1);
/// Where the file says what session it is of, and how that ended.
const METADATA: &str = "session";
const METADATA_AT_END: &str = "session_end";

/// What a recording may come to, so that the inspection and the uploads' limit will take it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Limits {
    /// Steps, by the memory that their images take once decoded.
    pub(super) steps: u64,
    pub(super) bytes: u64,
}

/// The recording of one session, while it is written.
pub(super) struct Tape {
    place: Place,
    slip: Slip,
    spec: TaskSpec,
    limits: Limits,
    /// Made with the first step, so that a session without any leaves nothing.
    file: Option<Open>,
    /// What came before the first step.
    early: Vec<Note>,
    steps: u64,
    /// Observations that do not fit the task.
    malformed: u64,
    /// Steps beyond the limits, or after the disk refused.
    beyond: u64,
    full: bool,
    /// The disk refused: what is on it up to then is what there is.
    broken: bool,
}

struct Open {
    writer: EpisodeWriter<BufWriter<File>>,
    /// The same file, to sync it.
    handle: File,
    /// When what was written must be on disk.
    sync_at: Option<Instant>,
}

impl Tape {
    /// Nothing is on disk yet.
    pub(super) fn new(place: Place, slip: Slip, spec: TaskSpec, limits: Limits) -> Self {
        let (file, steps, malformed, beyond) = (None, 0, 0, 0);
        let (early, full, broken) = (Vec::new(), false, false);
        Self { place, slip, spec, limits, file, early, steps, malformed, beyond, full, broken }
    }

    /// When to sync next; `None` while there is nothing to.
    pub(super) fn sync_at(&self) -> Option<Instant> {
        self.file.as_ref().and_then(|file| file.sync_at)
    }

    /// Writes a step. What does not fit is left out and counted.
    pub(super) fn step(&mut self, step: &Written) {
        if self.full || self.broken || self.steps >= self.limits.steps {
            self.beyond += 1;
            self.warn_full();
            return;
        }
        let written = match self.open() {
            Ok(()) => self.file.as_mut().map_or(Ok(()), |file| write_step(file, &self.spec, step)),
            Err(error) => Err(Fault::Disk(error)),
        };
        match written {
            Ok(()) => self.steps += u64::from(step.action.is_some()),
            Err(Fault::Misfit(problem)) => {
                tracing::debug!(
                    problem,
                    observation.stamp_ns = step.observation.stamp_ns,
                    "an observation is not recorded"
                );
                self.malformed += 1;
            }
            Err(Fault::Disk(error)) => {
                self.beyond += 1;
                self.give_up(&error);
            }
        }
    }

    /// Writes something beside the steps. Before the first of them it waits: without any there is to be no file.
    pub(super) fn note(&mut self, note: Note) {
        if self.full || self.broken {
            self.beyond += 1;
            return;
        }
        let Some(file) = &mut self.file else { return self.early.push(note) };
        let written = file.writer.annotate(note.topic, note.stamp_ns, &note.value);
        file.sync_at.get_or_insert_with(|| Instant::now() + SYNC_AFTER);
        if let Err(error) = written {
            self.give_up(&Error::internal("recording a session", error));
        }
    }

    /// Puts on disk what was written.
    pub(super) fn sync(&mut self) {
        let Some(file) = self.file.as_mut().filter(|_| !self.broken) else { return };
        match file.sync() {
            Ok(size) => {
                file.sync_at = None;
                self.full |= size >= self.limits.bytes;
            }
            Err(error) => self.give_up(&error),
        }
    }

    /// Ends the recording and says so on its slip. False when the session has left nothing.
    ///
    /// # Errors
    /// Internal when not even the slip can be written.
    pub(super) fn end(mut self, ending: &Ending) -> Result<bool> {
        let Some(mut file) = self.file.take() else {
            self.place.remove()?;
            return Ok(false);
        };
        self.slip.outcome = ending.outcome;
        if !self.broken {
            let values = self.tally(ending);
            let ended = file
                .writer
                .metadata(METADATA_AT_END, values)
                .and_then(|()| file.writer.finish())
                .map_err(|error| Error::internal("ending a recording", error))
                .and_then(|buffered| {
                    buffered.into_inner().map_err(|error| Error::internal("ending a recording", error))
                })
                .and_then(|_| file.handle.sync_all().map_err(fault("syncing", &self.place.recording())));
            match ended {
                Ok(()) => self.slip.steps = Some(self.steps),
                Err(error) => self.give_up(&error),
            }
        }
        self.place.write(&self.slip)?;
        Ok(true)
    }

    fn tally(&self, ending: &Ending) -> BTreeMap<String, String> {
        let counts = [
            ("answered", ending.answered),
            ("dropped", ending.dropped),
            ("missed", ending.missed),
            ("unscored", ending.unscored),
            ("steps", self.steps),
            ("left_out", ending.left_out + self.beyond),
            ("malformed", self.malformed),
        ];
        let counts = counts.into_iter().map(|(name, count)| (name.to_owned(), count.to_string()));
        counts.chain([("ended".to_owned(), ending.how.clone())]).collect()
    }

    /// Makes the file, if it is not there yet.
    fn open(&mut self) -> Result<()> {
        if self.file.is_none() {
            self.file = Some(create(&self.place, &self.slip, &self.spec)?);
            std::mem::take(&mut self.early).into_iter().for_each(|note| self.note(note));
        }
        Ok(())
    }

    fn give_up(&mut self, error: &Error) {
        if !std::mem::replace(&mut self.broken, true) {
            tracing::error!(
                error = error as &dyn std::error::Error, session.id = %self.slip.about.session_id,
                "the disk refuses a session's recording; what is on it is kept, the rest is lost"
            );
        }
    }

    fn warn_full(&mut self) {
        if !self.broken && !std::mem::replace(&mut self.full, true) {
            tracing::warn!(
                session.id = %self.slip.about.session_id, recording.steps = self.steps,
                "a session is longer than a recording may be: the rest is left out. Close sessions between episodes, or \
                 raise --inspect-memory-bytes and --max-upload-bytes"
            );
        }
    }
}

/// Why a step was not written.
enum Fault {
    /// It does not fit the task.
    Misfit(String),
    Disk(Error),
}

impl From<RecordingError> for Fault {
    fn from(error: RecordingError) -> Self {
        if matches!(error, RecordingError::Write(_) | RecordingError::Io { .. }) {
            return Self::Disk(Error::internal("recording a session", error));
        }
        Self::Misfit(error.to_string())
    }
}

/// The slip first, so that whatever is found of a recording can be kept.
fn create(place: &Place, slip: &Slip, spec: &TaskSpec) -> Result<Open> {
    place.write(slip)?;
    let path = place.recording();
    let file = File::create_new(&path).map_err(fault("making", &path))?;
    let handle = file.try_clone().map_err(fault("opening", &path))?;
    let about = &slip.about;
    let about = [
        ("session_id", about.session_id.to_string()),
        ("deployment", about.deployment.clone()),
        ("policy_id", about.policy_id.to_string()),
        ("score_run_id", about.score_run_id.as_ref().map(ToString::to_string).unwrap_or_default()),
        ("control_rate_hz", about.control_rate_hz.to_string()),
    ];
    let about = about.into_iter().map(|(name, value)| (name.to_owned(), value)).collect();
    let written = EpisodeWriter::create(BufWriter::new(file), spec).and_then(|mut writer| {
        writer.metadata(METADATA, about)?;
        Ok(writer)
    });
    let writer = written.map_err(|error| Error::internal("recording a session", error))?;
    let mut open = Open { writer, handle, sync_at: None };
    open.sync()?;
    path.parent().map_or(Ok(()), sync_folder)?;
    Ok(open)
}

impl Open {
    /// Puts everything on disk; gives the size it then has.
    fn sync(&mut self) -> Result<u64> {
        self.writer.flush().map_err(|error| Error::internal("recording a session", error))?;
        let synced = self.handle.sync_data().and_then(|()| self.handle.metadata());
        synced.map(|file| file.len()).map_err(|error| Error::internal("syncing a session's recording", error))
    }
}

fn write_step(file: &mut Open, spec: &TaskSpec, step: &Written) -> std::result::Result<(), Fault> {
    let observation = &step.observation;
    let cameras = cameras(spec, &observation.cameras)
        .ok_or_else(|| Fault::Misfit("its cameras are not the task's".to_owned()))?;
    let seen = ObservationRef { cameras: &cameras, proprioception: &observation.proprioception };
    if !step.sound {
        file.writer.check(seen)?;
    }
    file.writer.observe(observation.stamp_ns, seen)?;
    if let Some(action) = &step.action {
        file.writer.act(observation.stamp_ns, action)?;
    }
    file.sync_at.get_or_insert_with(|| Instant::now() + SYNC_AFTER);
    Ok(())
}

/// What was seen, in the task's order; `None` when it is not by the task's cameras.
fn cameras<'a>(spec: &TaskSpec, frames: &'a [CameraFrame]) -> Option<Vec<CameraRef<'a>>> {
    let one = |camera: &gleaner_recording::CameraSpec| {
        let frame = frames.iter().find(|frame| frame.camera == camera.name)?;
        let color = image(frame.color.as_ref()?, PixelFormat::Rgb8);
        Some(CameraRef { color, depth: frame.depth.as_ref().map(|depth| image(depth, PixelFormat::Depth16)) })
    };
    let cameras: Option<Vec<_>> = spec.cameras.iter().map(one).collect();
    cameras.filter(|cameras| cameras.len() == frames.len())
}

fn image(image: &Image, raw: PixelFormat) -> ImageRef<'_> {
    let format = match image.format {
        ImageFormat::Any => PixelFormat::Auto,
        ImageFormat::Jpeg => PixelFormat::Jpeg,
        ImageFormat::Png => PixelFormat::Png,
        ImageFormat::Raw => raw,
    };
    ImageRef { format, data: &image.data }
}
