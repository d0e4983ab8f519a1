//! Writes an episode as MCAP in the foxglove/protobuf dialect: what the simulator and recorded sessions use.
//!
//! A whole step's color becomes JPEG in foxglove.CompressedImage and its depth stays exact in foxglove.RawImage; images
//! that came from elsewhere are kept as they came. The numbers go to `/robot/state` and `/robot/action`.
//! [`written_mapping`] reads all of it back.

mod images;
mod mapping;
mod observed;
pub(crate) mod schema;
mod streams;

use std::collections::BTreeMap;
use std::io::{Seek, Write};

use mcap::records::{MessageHeader, Metadata};
use prost_types::Timestamp;

use crate::error::RecordingError;
use crate::frames::frame_bytes_per_step;
use crate::picture::Channel;
use crate::validate::validate;
use gleaner_core::{FieldSpec, TaskSpec};
use images::ImageChannels;
use mapping::STATE_TOPIC;
use schema::{Numbers, Schema};

pub(crate) use mapping::ACTION_TOPIC;
pub use mapping::written_mapping;
pub use observed::{CameraRef, ImageRef, ObservationRef};
pub use streams::CameraMessage;

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

/// Writes an episode step by step.
pub struct EpisodeWriter<W: Write + Seek> {
    mcap: mcap::Writer<W>,
    spec: TaskSpec,
    images: ImageChannels,
    /// For each camera with video its channel and the last time of logging.
    videos: BTreeMap<usize, (u16, u64)>,
    /// Absent when the task has no proprioception.
    state: Option<(u16, Numbers)>,
    action: (u16, Numbers),
    notes: BTreeMap<String, u16>,
    steps: u32,
}

impl<W: Write + Seek> EpisodeWriter<W> {
    /// Begins a recording.
    ///
    /// # Errors
    /// [`RecordingError::Spec`] or [`RecordingError::Write`].
    pub fn create(writer: W, spec: &TaskSpec) -> Result<Self, RecordingError> {
        validate(spec)?;
        let mut mcap = mcap_writer(writer, "")?;
        let mut add_numbers = |topic, name, specs: &[FieldSpec]| {
            let schema = schema::numbers(name, specs);
            let wrong =
                || RecordingError::Spec { field: name.into(), problem: "the fields do not form a message".into() };
            let numbers = Numbers::new(&schema, specs).ok_or_else(wrong)?;
            Ok::<_, RecordingError>((add_channel(&mut mcap, topic, &schema)?, numbers))
        };
        let state = (!spec.proprioception.is_empty())
            .then(|| add_numbers(STATE_TOPIC, "State", &spec.proprioception))
            .transpose()?;
        let action = add_numbers(ACTION_TOPIC, "Action", &spec.action)?;
        let (images, videos, notes) = (ImageChannels::default(), BTreeMap::new(), BTreeMap::new());
        Ok(Self { mcap, spec: spec.clone(), images, videos, state, action, notes, steps: 0 })
    }

    /// Writes one step's images, state and action, all with this stamp.
    ///
    /// # Errors
    /// [`RecordingError::Step`] if the step does not fit the task, or [`RecordingError::Write`].
    pub fn step(&mut self, stamp_ns: i64, step: StepRef<'_>) -> Result<(), RecordingError> {
        self.check_step(stamp_ns, step)?;
        let mut rest = step.frames;
        for at in 0..self.spec.cameras.len() {
            rest = self.frame(at, stamp_ns, rest)?;
        }
        self.state(stamp_ns, step.proprioception)?;
        self.action(stamp_ns, step.action)
    }

    /// Writes a JSON message that mappings ignore. The topic must not be one of the step's own.
    ///
    /// # Errors
    /// [`RecordingError::Step`] for a topic of the steps, or [`RecordingError::Write`].
    pub fn annotate(&mut self, topic: &str, stamp_ns: i64, value: &serde_json::Value) -> Result<(), RecordingError> {
        let own = written_mapping(&self.spec);
        if own.topics(&self.spec).contains(topic) {
            return Err(self.wrong(format!("{topic} holds the steps themselves; annotate on another topic")));
        }
        let channel = match self.notes.get(topic) {
            Some(&channel) => channel,
            None => {
                let channel =
                    self.mcap.add_channel(0, topic, "json", &BTreeMap::new()).map_err(RecordingError::Write)?;
                self.notes.insert(topic.to_owned(), channel);
                channel
            }
        };
        self.write(channel, stamp_ns, value.to_string().as_bytes())
    }

    /// Writes a named map of strings into the file.
    ///
    /// # Errors
    /// [`RecordingError::Write`].
    pub fn metadata(&mut self, name: &str, values: BTreeMap<String, String>) -> Result<(), RecordingError> {
        self.mcap.write_metadata(&Metadata { name: name.to_owned(), metadata: values }).map_err(RecordingError::Write)
    }

    /// Flushes everything so far to the underlying writer in a form that can be read even if nothing follows.
    ///
    /// # Errors
    /// [`RecordingError::Write`].
    pub fn flush(&mut self) -> Result<(), RecordingError> {
        self.mcap.flush().map_err(RecordingError::Write)
    }

    /// Ends the file; returns the writer.
    ///
    /// # Errors
    /// [`RecordingError::Write`].
    pub fn finish(mut self) -> Result<W, RecordingError> {
        self.mcap.finish().map_err(RecordingError::Write)?;
        Ok(self.mcap.into_inner())
    }

    fn check_step(&self, stamp_ns: i64, step: StepRef<'_>) -> Result<(), RecordingError> {
        self.check_stamp(stamp_ns)?;
        self.check_size("frames", step.frames.len(), frame_bytes_per_step(&self.spec))?;
        self.check_size("proprioception", step.proprioception.len(), self.spec.proprioception_size())?;
        self.check_size("action", step.action.len(), self.spec.action_size())
    }

    fn check_stamp(&self, stamp_ns: i64) -> Result<(), RecordingError> {
        if stamp_ns < 0 {
            return Err(self.wrong(format!("the stamp {stamp_ns} is negative; give one from 0 on")));
        }
        Ok(())
    }

    fn check_size(&self, what: &str, found: usize, wanted: usize) -> Result<(), RecordingError> {
        if found != wanted {
            return Err(self.wrong(format!("{what} has {found} elements, a step of the task has {wanted}")));
        }
        Ok(())
    }

    fn wrong(&self, problem: String) -> RecordingError {
        RecordingError::Step { step: self.steps.into(), problem }
    }

    /// Writes the images of one camera from the front of the frames; returns the rest.
    fn frame<'a>(&mut self, at: usize, stamp_ns: i64, frames: &'a [u8]) -> Result<&'a [u8], RecordingError> {
        let camera = &self.spec.cameras[at];
        let (rgb, rest) = frames.split_at(Channel::Color.bytes(camera));
        let (depth, rest) = rest.split_at(if camera.depth { Channel::Depth.bytes(camera) } else { 0 });
        let (jpeg, size) = (images::jpeg(camera, rgb)?, camera.sizes().step());
        self.image(at, Channel::Color, stamp_ns, images::Kept::Compressed("jpeg", &jpeg))?;
        if !depth.is_empty() {
            self.image(at, Channel::Depth, stamp_ns, images::Kept::Raw(size, depth))?;
        }
        Ok(rest)
    }

    fn state(&mut self, stamp_ns: i64, values: &[f32]) -> Result<(), RecordingError> {
        let Some((channel, numbers)) = &self.state else { return Ok(()) };
        let (channel, bytes) = (*channel, numbers.encode(&timestamp(stamp_ns), values));
        self.numbers(channel, stamp_ns, bytes)
    }

    /// The action ends its step.
    fn action(&mut self, stamp_ns: i64, values: &[f32]) -> Result<(), RecordingError> {
        let bytes = self.action.1.encode(&timestamp(stamp_ns), values);
        self.numbers(self.action.0, stamp_ns, bytes)?;
        self.steps = self.steps.saturating_add(1);
        Ok(())
    }

    fn numbers(&mut self, channel: u16, stamp_ns: i64, bytes: Option<Vec<u8>>) -> Result<(), RecordingError> {
        let bytes = bytes.ok_or_else(|| self.wrong("the values do not fit the task's fields".to_owned()))?;
        self.write(channel, stamp_ns, &bytes)
    }

    fn write(&mut self, channel_id: u16, stamp_ns: i64, data: &[u8]) -> Result<(), RecordingError> {
        let time = u64::try_from(stamp_ns).unwrap_or_default();
        let header = MessageHeader { channel_id, sequence: self.steps, log_time: time, publish_time: time };
        self.mcap.write_to_known_channel(&header, data).map_err(RecordingError::Write)
    }
}

/// A crash loses the chunk that is being written, so chunks are small; images are compressed already.
const CHUNK_BYTES: u64 = 64 << 10;

/// An MCAP writer as this crate uses it: zstd, small chunks, and no threads of its own.
pub(crate) fn mcap_writer<W: Write + Seek>(writer: W, profile: &str) -> Result<mcap::Writer<W>, RecordingError> {
    let library = concat!("gleaner-recording/", env!("CARGO_PKG_VERSION"));
    let options = write_options(profile, CHUNK_BYTES).library(library);
    options.create(writer).map_err(RecordingError::Write)
}

/// The options of every MCAP writer of this crate: their bytes follow from what is written.
pub(crate) fn write_options(profile: &str, chunk_bytes: u64) -> mcap::WriteOptions {
    mcap::WriteOptions::new()
        .compression_threads(0)
        // A chunk is then written in one piece and not changed afterwards, so that a crash leaves complete chunks and a tail.
        .disable_seeking(true)
        .chunk_size(Some(chunk_bytes))
        .profile(profile)
}

/// A channel of protobuf messages.
pub(crate) fn add_channel<W: Write + Seek>(
    mcap: &mut mcap::Writer<W>,
    topic: &str,
    schema: &Schema,
) -> Result<u16, RecordingError> {
    let schema = mcap.add_schema(&schema.name, "protobuf", &schema.descriptors).map_err(RecordingError::Write)?;
    mcap.add_channel(schema, topic, "protobuf", &BTreeMap::new()).map_err(RecordingError::Write)
}

/// A stamp as protobuf has it.
pub(crate) fn timestamp(stamp_ns: i64) -> Timestamp {
    // The remainder is below 1e9, which fits.
    let nanos = i32::try_from(stamp_ns.rem_euclid(1_000_000_000)).unwrap_or_default();
    Timestamp { seconds: stamp_ns.div_euclid(1_000_000_000), nanos }
}

#[cfg(test)]
pub(crate) mod tests;
