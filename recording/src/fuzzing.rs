//! Doors for the fuzzer to what is private here. Built with the feature `fuzzing` only, which nothing that ships
//! turns on.

use crate::dialect::{ChannelSchema, Decoder, Value};
use crate::image::RawImage;
use crate::limits::Limits;
use crate::path::Path;
use crate::picture::{self, Channel};
use crate::spec::CameraSpec;

/// Reads a message of any dialect the way a recording's are read, and asks for everything that is asked of one:
/// its stamp, the numbers at `path`, by name too, and its image.
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
    if let Ok(rgb) = crate::image::raw_color(image, wanted.0, wanted.1) {
        assert_eq!(rgb.len() as u64, u64::from(wanted.0) * u64::from(wanted.1) * 3);
    }
    if let Ok(depth) = crate::image::raw_depth(image, wanted.0, wanted.1) {
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
    let camera = CameraSpec { name: "c".to_owned(), height: 8, width: 8, depth: true };
    for channel in [Channel::Color, Channel::Depth] {
        if let Ok(pixels) = picture::decode(message, channel, &camera) {
            assert_eq!(pixels.len(), channel.bytes(&camera));
        }
    }
}
