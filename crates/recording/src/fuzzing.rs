//! Access of the fuzzer to private functions. Built with the feature `fuzzing` only, which releases do not enable.

use std::collections::BTreeMap;

use crate::container::{Record, scan};
use crate::dialect::{ChannelSchema, Decoder, Value};
use crate::error::RecordingError;
use crate::image::RawImage;
use crate::limits::Limits;
use crate::path::Path;
use crate::picture::{self, Channel};
use crate::tracks::collect;
use gleaner_core::{CameraSpec, PictureSizes, TaskSpec};

pub use crate::mutants::{KINDS, Random, mutant};

/// Reads a message of any dialect like the messages of a recording: its stamp, the numbers at `path`, also by name, and its
/// image.
pub fn message(encodings: (&str, &str), (name, schema): (&str, &[u8]), bytes: &[u8], path: &str) {
    let (message_encoding, schema_encoding) = encodings;
    let described = ChannelSchema { message_encoding, schema_encoding, name, data: schema };
    let Ok(decoder) = Decoder::new(described, &Limits::default()) else { return };
    if let Ok(message) = decoder.decode(bytes) {
        look(&message, path);
    }
}

/// Decodes an uncompressed image of this size; `kind` chooses its encoding.
pub fn raw_image(kind: u8, (height, width, step): (u32, u32, u32), wanted: (u32, u32), data: &[u8]) {
    const ENCODINGS: [&str; 9] = ["rgb8", "bgr8", "rgba8", "bgra8", "mono8", "16UC1", "mono16", "32FC1", "8UC3"];
    let encoding = ENCODINGS[usize::from(kind) % ENCODINGS.len()];
    let image = RawImage { height, width, encoding, step, big_endian: kind >= 128, data };
    let sizes = PictureSizes::new(wanted.0, wanted.1);
    if let Ok(rgb) = crate::image::raw_color(image, &sizes) {
        assert_eq!(rgb.len() as u64, u64::from(wanted.0) * u64::from(wanted.1) * 3);
    }
    if let Ok(depth) = crate::image::raw_depth(image, &sizes) {
        assert_eq!(depth.len() as u64, u64::from(wanted.0) * u64::from(wanted.1) * 2);
    }
}

fn look(message: &Value<'_>, path: &str) {
    let _ = message.stamp();
    if let Ok(path) = Path::parse(path) {
        let mut numbers = Vec::new();
        let _ = path.numbers(message, &mut numbers);
        let _ = path.numbers_by_name(message, &["a".to_owned(), "b".to_owned()], &mut numbers);
    }
    let camera = CameraSpec { name: "c".to_owned(), height: 8, width: 8, depth: true, recorded: None };
    for channel in [Channel::Color, Channel::Depth] {
        if let Ok(pixels) = picture::decode(message, channel, &camera) {
            assert_eq!(pixels.len(), channel.bytes(&camera));
        }
    }
}

/// Sums over one topic. They are CRC-32, so that any other language can compute them too.
#[derive(Debug, Default)]
pub struct TopicSums {
    /// Number of messages.
    pub messages: u64,
    /// Over each message's log time and bytes, in the order in which they were read.
    pub ordered: u32,
    /// The sum of one CRC-32 for each message: the same in any order.
    pub unordered: u64,
    /// Over each message's header stamp (0 without one); of the topics that the mapping reads.
    pub stamps: u32,
    /// Over the bytes of each message's image, decoded from base64 where it is text; of the cameras' topics.
    pub images: u32,
}

/// Sums over a recording, by topic, and by field with the number of its messages and the CRC-32 of its values as 32-bit
/// floats.
#[derive(Debug, Default)]
pub struct Sums {
    /// By topic.
    pub topics: BTreeMap<String, TopicSums>,
    /// By field of the task.
    pub fields: BTreeMap<String, (u64, u32)>,
}

/// Sums up everything that is read from a recording with this mapping of the task, to compare it with another reader.
///
/// # Errors
/// Like [`crate::read_episode`], if the file cannot be read.
pub fn sums(path: &std::path::Path, spec: &TaskSpec, mapping: &str) -> Result<Sums, RecordingError> {
    let mut spec = spec.clone();
    spec.mappings.retain(|known| known.name == mapping);
    let mut tracks = collect(path, &spec, &Limits::default())?;
    let mut sums = Sums::default();
    scan(path, &Limits::default(), &mut |record| {
        let Record::Message { header, data } = record else { return Ok(()) };
        let Some((topic, _, decoder)) = tracks.channels.next(header.channel_id) else { return Ok(()) };
        let entry = sums.topics.entry(topic.to_owned()).or_default();
        let time = header.log_time.to_le_bytes();
        let length = (data.len() as u64).to_le_bytes();
        entry.messages += 1;
        entry.ordered = crc(entry.ordered, &[&time, &length, data]);
        entry.unordered = entry.unordered.wrapping_add(crc(0, &[&time, data]).into());
        let camera = spec.mappings.iter().flat_map(|mapping| &mapping.cameras);
        if camera.flat_map(|source| [Some(&source.color), source.depth.as_ref()]).flatten().any(|known| known == topic)
            && let Ok(Ok(message)) = decoder.as_ref().as_ref().map(|decoder| decoder.decode(data))
            && let Ok(image) = picture::data(&message)
        {
            entry.images = crc(entry.images, &[&image]);
        }
        Ok(())
    })?;
    for (topic, track) in &tracks.tracks {
        let stamps = track.stamps.iter().map(|stamp| stamp.header.unwrap_or_default());
        let entry = sums.topics.entry(topic.clone()).or_default();
        entry.stamps = stamps.fold(0, |sum, stamp| crc(sum, &[&stamp.to_le_bytes()]));
        for field in &track.fields {
            let values = field.values.iter().map(|value| if value.is_nan() { f32::NAN } else { *value });
            let sum = values.fold(0, |sum, value| crc(sum, &[&value.to_le_bytes()]));
            let name = &spec.mappings[field.mapping].fields[field.source].field;
            sums.fields.insert(name.clone(), (field.messages.len() as u64, sum));
        }
    }
    Ok(sums)
}

fn crc(so_far: u32, parts: &[&[u8]]) -> u32 {
    let mut hasher = crc32fast::Hasher::new_with_initial(so_far);
    parts.iter().for_each(|part| hasher.update(part));
    hasher.finalize()
}
