//! The file of one recorded session while it is open: what goes into it, and when that is on disk. Knows no limits.

use std::{
    collections::BTreeMap,
    fs::File,
    io::BufWriter,
    time::{Duration, Instant},
};

use gleaner_recording::{CameraRef, EpisodeWriter, ImageRef, ObservationRef, PixelFormat, RecordingError, TaskSpec};

use super::{
    about::{Place, Slip, fault},
    event::{Note, Written},
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

/// A recording that is being written.
pub(super) struct Open {
    writer: EpisodeWriter<BufWriter<File>>,
    /// The same file, to sync it.
    handle: File,
    /// When what was written must be on disk.
    sync_at: Option<Instant>,
    /// Its bytes at the last sync.
    size: u64,
    /// Most bytes that have come since.
    unsynced: u64,
}

/// Why a step was not written.
pub(super) enum Fault {
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

impl Open {
    /// Makes the file. The slip first, so that whatever is found of a recording can be kept.
    pub(super) fn create(place: &Place, slip: &Slip, spec: &TaskSpec) -> Result<Self> {
        place.write(slip)?;
        let path = place.recording();
        let file = File::create_new(&path).map_err(fault("making", &path))?;
        let handle = file.try_clone().map_err(fault("opening", &path))?;
        let written = EpisodeWriter::create(BufWriter::new(file), spec).and_then(|mut writer| {
            writer.metadata(METADATA, about(slip))?;
            Ok(writer)
        });
        let writer = written.map_err(|error| Error::internal("recording a session", error))?;
        let mut open = Self { writer, handle, sync_at: None, size: 0, unsynced: 0 };
        open.sync()?;
        path.parent().map_or(Ok(()), sync_folder)?;
        Ok(open)
    }

    /// When to sync next; `None` while there is nothing to.
    pub(super) fn sync_at(&self) -> Option<Instant> {
        self.sync_at
    }

    /// Most bytes that it may have once everything is on disk.
    pub(super) fn most(&self) -> u64 {
        self.size.saturating_add(self.unsynced)
    }

    /// Puts everything on disk.
    pub(super) fn sync(&mut self) -> Result<()> {
        self.writer.flush().map_err(|error| Error::internal("recording a session", error))?;
        let synced = self.handle.sync_data().and_then(|()| self.handle.metadata());
        let file = synced.map_err(|error| Error::internal("syncing a session's recording", error))?;
        crate::fail_point::pass("rollout.synced");
        (self.size, self.unsynced, self.sync_at) = (file.len(), 0, None);
        Ok(())
    }

    /// Writes a step of at most so many bytes.
    pub(super) fn step(&mut self, spec: &TaskSpec, step: &Written, bytes: u64) -> std::result::Result<(), Fault> {
        let observation = &step.observation;
        let cameras = cameras(spec, &observation.cameras)
            .ok_or_else(|| Fault::Misfit("its cameras are not the task's".to_owned()))?;
        let seen = ObservationRef { cameras: &cameras, proprioception: &observation.proprioception };
        if !step.sound {
            self.writer.check(seen)?;
        }
        self.wrote(bytes);
        self.writer.observe(observation.stamp_ns, seen)?;
        if let Some(action) = &step.action {
            self.writer.act(observation.stamp_ns, action)?;
        }
        Ok(())
    }

    /// Writes something beside the steps, of at most so many bytes.
    pub(super) fn note(&mut self, note: &Note, bytes: u64) -> Result<()> {
        self.wrote(bytes);
        let written = self.writer.annotate(note.topic, note.stamp_ns, &note.value);
        written.map_err(|error| Error::internal("recording a session", error))
    }

    /// Ends the file, with these last words; it is whole and on disk then.
    pub(super) fn finish(mut self, last: BTreeMap<String, String>) -> Result<()> {
        let ended = self.writer.metadata(METADATA_AT_END, last).and_then(|()| self.writer.finish());
        let buffered = ended.map_err(|error| Error::internal("ending a recording", error))?;
        buffered.into_inner().map_err(|error| Error::internal("ending a recording", error))?;
        self.handle.sync_all().map_err(|error| Error::internal("syncing a session's recording", error))
    }

    fn wrote(&mut self, bytes: u64) {
        self.unsynced = self.unsynced.saturating_add(bytes);
        self.sync_at.get_or_insert_with(|| Instant::now() + SYNC_AFTER);
    }
}

fn about(slip: &Slip) -> BTreeMap<String, String> {
    let about = &slip.about;
    let about = [
        ("session_id", about.session_id.to_string()),
        ("deployment", about.deployment.clone()),
        ("policy_id", about.policy_id.to_string()),
        ("score_run_id", about.score_run_id.as_ref().map(ToString::to_string).unwrap_or_default()),
        ("control_rate_hz", about.control_rate_hz.to_string()),
    ];
    about.into_iter().map(|(name, value)| (name.to_owned(), value)).collect()
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
