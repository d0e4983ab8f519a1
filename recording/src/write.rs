//! Writes an episode as MCAP in the foxglove/protobuf dialect: what the simulator and recorded sessions use.
//!
//! Color becomes JPEG in foxglove.CompressedImage, depth stays exact in foxglove.RawImage, and the numbers go
//! to `/robot/state` and `/robot/action`. [`written_mapping`] reads all of it back.

mod mapping;
pub(crate) mod schema;

use std::collections::BTreeMap;
use std::io::{Seek, Write};

use mcap::records::{MessageHeader, Metadata};
use prost::Message as _;
use prost_types::Timestamp;

use crate::error::RecordingError;
use crate::frames::frame_bytes_per_step;
use crate::image::encode_jpeg;
use crate::picture::Channel;
use crate::spec::{FieldSpec, TaskSpec};
use mapping::{ACTION_TOPIC, STATE_TOPIC, color_topic, depth_topic};
use schema::{CompressedImage, Numbers, RawImage, Schema};

pub use mapping::written_mapping;

const JPEG_QUALITY: u8 = 92;

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
    spec: TaskSpec,
    /// Color and depth of each camera.
    cameras: Vec<(u16, Option<u16>)>,
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
        spec.validate()?;
        let mut mcap = mcap_writer(writer, "")?;
        let mut cameras = Vec::new();
        for camera in &spec.cameras {
            let color = add_channel(&mut mcap, &color_topic(camera), &schema::compressed_image())?;
            let depth =
                camera.depth.then(|| add_channel(&mut mcap, &depth_topic(camera), &schema::raw_image())).transpose()?;
            cameras.push((color, depth));
        }
        let mut add_numbers = |topic, name, specs: &[FieldSpec]| {
            let schema = schema::numbers(name, specs);
            let wrong = || RecordingError::Spec { field: name.into(), problem: "the fields make no message".into() };
            let numbers = Numbers::new(&schema, specs).ok_or_else(wrong)?;
            Ok::<_, RecordingError>((add_channel(&mut mcap, topic, &schema)?, numbers))
        };
        let state = (!spec.proprioception.is_empty())
            .then(|| add_numbers(STATE_TOPIC, "State", &spec.proprioception))
            .transpose()?;
        let action = add_numbers(ACTION_TOPIC, "Action", &spec.action)?;
        Ok(Self { mcap, spec: spec.clone(), cameras, state, action, notes: BTreeMap::new(), steps: 0 })
    }

    /// Writes one step's images, state and action, all with this stamp.
    ///
    /// # Errors
    /// [`RecordingError::Step`] when the step does not fit the task, or [`RecordingError::Write`].
    pub fn step(&mut self, stamp_ns: i64, step: StepRef<'_>) -> Result<(), RecordingError> {
        self.check(stamp_ns, step)?;
        let stamp = timestamp(stamp_ns);
        let mut rest = step.frames;
        for at in 0..self.spec.cameras.len() {
            rest = self.images(at, stamp_ns, rest)?;
        }
        let state =
            self.state.as_ref().map(|(channel, numbers)| (*channel, numbers.encode(&stamp, step.proprioception)));
        let action = Some((self.action.0, self.action.1.encode(&stamp, step.action)));
        for (channel, bytes) in state.into_iter().chain(action) {
            let bytes = bytes.ok_or_else(|| self.wrong("the values do not fit the task's fields".to_owned()))?;
            self.write(channel, stamp_ns, &bytes)?;
        }
        self.steps = self.steps.saturating_add(1);
        Ok(())
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

    /// Ends the file and gives the writer back.
    ///
    /// # Errors
    /// [`RecordingError::Write`].
    pub fn finish(mut self) -> Result<W, RecordingError> {
        self.mcap.finish().map_err(RecordingError::Write)?;
        Ok(self.mcap.into_inner())
    }

    fn check(&self, stamp_ns: i64, step: StepRef<'_>) -> Result<(), RecordingError> {
        if stamp_ns <= 0 {
            return Err(self.wrong(format!("the stamp {stamp_ns} is not after 1970; give nanoseconds of Unix time")));
        }
        for (what, found, wanted) in [
            ("frames", step.frames.len(), frame_bytes_per_step(&self.spec)),
            ("proprioception", step.proprioception.len(), self.spec.proprioception_size()),
            ("action", step.action.len(), self.spec.action_size()),
        ] {
            if found != wanted {
                return Err(self.wrong(format!("{what} has {found} elements, the task's steps have {wanted}")));
            }
        }
        Ok(())
    }

    fn wrong(&self, problem: String) -> RecordingError {
        RecordingError::Step { step: self.steps.into(), problem }
    }

    /// Writes the images of one camera from the front of the frames and gives the rest back.
    fn images<'a>(&mut self, at: usize, stamp_ns: i64, frames: &'a [u8]) -> Result<&'a [u8], RecordingError> {
        let (camera, (color, depth)) = (&self.spec.cameras[at], self.cameras[at]);
        let (height, width, frame_id) = (camera.height, camera.width, camera.name.clone());
        let (rgb, mut rest) = frames.split_at(Channel::Color.bytes(camera));
        let stamp = Some(timestamp(stamp_ns));
        let data = encode_jpeg(rgb, height, width, JPEG_QUALITY)?;
        let image = CompressedImage { timestamp: stamp, data, format: "jpeg".to_owned(), frame_id: frame_id.clone() };
        let depth_bytes = Channel::Depth.bytes(camera);
        self.write(color, stamp_ns, &image.encode_to_vec())?;
        if let Some(depth) = depth {
            let (data, after) = rest.split_at(depth_bytes);
            rest = after;
            let encoding = "16UC1".to_owned();
            let image =
                RawImage { timestamp: stamp, width, height, encoding, step: width * 2, data: data.to_vec(), frame_id };
            self.write(depth, stamp_ns, &image.encode_to_vec())?;
        }
        Ok(rest)
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
    let options = mcap::WriteOptions::new()
        .compression_threads(0)
        .chunk_size(Some(CHUNK_BYTES))
        .profile(profile)
        .library(concat!("gleaner-recording/", env!("CARGO_PKG_VERSION")));
    options.create(writer).map_err(RecordingError::Write)
}

fn add_channel<W: Write + Seek>(
    mcap: &mut mcap::Writer<W>,
    topic: &str,
    schema: &Schema,
) -> Result<u16, RecordingError> {
    let schema = mcap.add_schema(&schema.name, "protobuf", &schema.descriptors).map_err(RecordingError::Write)?;
    mcap.add_channel(schema, topic, "protobuf", &BTreeMap::new()).map_err(RecordingError::Write)
}

fn timestamp(stamp_ns: i64) -> Timestamp {
    // The remainder is below 1e9, which fits.
    let nanos = i32::try_from(stamp_ns.rem_euclid(1_000_000_000)).unwrap_or_default();
    Timestamp { seconds: stamp_ns.div_euclid(1_000_000_000), nanos }
}

#[cfg(test)]
pub(crate) mod tests;
