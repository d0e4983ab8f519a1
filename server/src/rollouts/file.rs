//! The open file of one recorded session: its writes and their syncs. Must not depend on limits.

use std::{
    collections::BTreeMap,
    fs::File,
    io::BufWriter,
    time::{Duration, Instant},
};

use gleaner_recording::{CameraRef, EpisodeWriter, ImageRef, ObservationRef, PixelFormat, RecordingError, TaskSpec};

use super::{
    event::{Note, Written},
    sidecar::{RolloutFiles, RolloutSidecar, fault},
};
use crate::{
    blobs::sync_folder,
    domain::observation::{CameraFrame, Image, ImageFormat},
    error::{Error, Result},
};

/// The most time between syncs, and so the most that a crash loses.
const SYNC_AFTER: Duration = Duration::from_secs(1);
/// Names of the metadata records for the session and its end.
const METADATA: &str = "session";
const METADATA_AT_END: &str = "session_end";

/// A recording that is being written.
pub(super) struct Open {
    writer: EpisodeWriter<BufWriter<File>>,
    /// The same file, to sync it.
    handle: File,
    /// When written data must be on disk.
    sync_at: Option<Instant>,
    /// Its size at the last sync.
    size: u64,
    /// The most bytes written since.
    unsynced: u64,
}

/// Why a step was not written.
pub(super) enum Fault {
    /// The step does not fit the task.
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
    /// Creates the file. The sidecar first, so that any recording found later can be stored.
    pub(super) fn create(files: &RolloutFiles, sidecar: &RolloutSidecar, spec: &TaskSpec) -> Result<Self> {
        files.write(sidecar)?;
        let path = files.recording();
        let file = File::create_new(&path).map_err(fault("making", &path))?;
        let handle = file.try_clone().map_err(fault("opening", &path))?;
        let written = EpisodeWriter::create(BufWriter::new(file), spec).and_then(|mut writer| {
            writer.metadata(METADATA, session_metadata(sidecar))?;
            Ok(writer)
        });
        let writer = written.map_err(|error| Error::internal("recording a session", error))?;
        let mut open = Self { writer, handle, sync_at: None, size: 0, unsynced: 0 };
        open.sync()?;
        path.parent().map_or(Ok(()), sync_folder)?;
        Ok(open)
    }

    /// When to sync next; `None` while everything is synced.
    pub(super) fn sync_at(&self) -> Option<Instant> {
        self.sync_at
    }

    /// The most bytes of the file once everything is on disk.
    pub(super) fn most(&self) -> u64 {
        self.size.saturating_add(self.unsynced)
    }

    /// Syncs the file.
    pub(super) fn sync(&mut self) -> Result<()> {
        self.writer.flush().map_err(|error| Error::internal("recording a session", error))?;
        let synced = self.handle.sync_data().and_then(|()| self.handle.metadata());
        let file = synced.map_err(|error| Error::internal("syncing a session's recording", error))?;
        crate::fail_point::pass("rollout.synced");
        (self.size, self.unsynced, self.sync_at) = (file.len(), 0, None);
        Ok(())
    }

    /// Writes a step of at most `bytes` bytes.
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

    /// Writes a note of at most `bytes` bytes.
    pub(super) fn note(&mut self, note: &Note, bytes: u64) -> Result<()> {
        self.wrote(bytes);
        let written = self.writer.annotate(note.topic, note.stamp_ns, &note.value);
        written.map_err(|error| Error::internal("recording a session", error))
    }

    /// Ends the file with this metadata; it is whole and on disk afterwards.
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

fn session_metadata(sidecar: &RolloutSidecar) -> BTreeMap<String, String> {
    let session = &sidecar.session;
    let entries = [
        ("session_id", session.session_id.to_string()),
        ("deployment", session.deployment.clone()),
        ("policy_id", session.policy_id.to_string()),
        ("score_run_id", session.score_run_id.as_ref().map(ToString::to_string).unwrap_or_default()),
        ("control_rate_hz", session.control_rate_hz.to_string()),
    ];
    entries.into_iter().map(|(name, value)| (name.to_owned(), value)).collect()
}

/// The frames in the task's order; `None` when they are not of the task's cameras.
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
