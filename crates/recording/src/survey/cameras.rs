//! The images of a topic: their encoding, their size, and the first picture.

use std::path::Path;

use crate::dialect::Value;
use crate::error::RecordingError;
use crate::image::{Header, encode_jpeg};
use crate::limits::Limits;
use crate::picture::{self, Channel};
use crate::video;
use gleaner_core::{CameraSpec, SurveyedCamera};

/// Quality of the pictures that are written.
const QUALITY: u8 = 90;
/// Longest part of a topic in a picture's file name.
const MAX_NAME: usize = 64;

/// What is known of a topic's images so far.
#[derive(Default)]
pub(super) struct CameraNotes {
    found: SurveyedCamera,
    /// RGB of the first picture that can be decoded, with its own height and width: those of the topic are of the first
    /// image that is described.
    picture: Option<(Vec<u8>, (u32, u32))>,
    video: video::FirstPicture,
}

/// One image as its message describes it.
struct Described {
    depth: bool,
    encoding: String,
    size: (u32, u32),
}

impl CameraNotes {
    /// Whether a message has the fields of an image or of a packet of video.
    pub(super) fn is_image(message: &Value<'_>) -> bool {
        if picture::address(message).is_some() {
            return true;
        }
        let data = message.bytes("data").is_some() || message.text("data").is_some();
        let raw = message.text("encoding").is_some()
            && (message.number("pts").is_some()
                || (message.number("width").is_some() && message.number("height").is_some()));
        data && (raw || message.text("format").is_some())
    }

    /// Adds a message.
    pub(super) fn push(&mut self, message: &Value<'_>, limits: &Limits, pictures: bool) {
        let described = match video::packet(message) {
            Some(Ok(packet)) => {
                self.found.encoding = packet.codec.to_string();
                self.video(&packet, limits, pictures);
                return;
            }
            Some(Err(error)) => Err(error),
            None => describe(message, limits),
        };
        match described {
            Ok(Described { depth, encoding, size }) => {
                let (height, width) = size;
                if self.found.height == 0 {
                    (self.found.depth, self.found.encoding) = (depth, encoding);
                    (self.found.height, self.found.width) = (height, width);
                } else if (self.found.height, self.found.width) != size {
                    self.found.other_sizes += 1;
                }
                if pictures && self.picture.is_none() {
                    self.picture = rgb(message, depth, size).ok().map(|rgb| (rgb, size));
                }
            }
            Err(error) => self.fail(&error),
        }
    }

    fn video(&mut self, packet: &video::Packet<'_>, limits: &Limits, pictures: bool) {
        match self.video.push(packet, limits.image_pixels, pictures) {
            Some(Ok((size, picture))) => {
                (self.found.height, self.found.width) = size;
                self.picture = picture.map(|rgb| (rgb, size));
            }
            Some(Err(error)) => self.fail(&error),
            None => {}
        }
    }

    fn fail(&mut self, error: &RecordingError) {
        self.found.problem.get_or_insert(error.to_string());
        self.found.unreadable += 1;
    }

    /// The result; the picture is written into the folder under a name with this number. One that cannot be encoded is
    /// left out.
    pub(super) fn finish(
        self,
        topic: &str,
        pictures: Option<(&Path, usize)>,
    ) -> Result<SurveyedCamera, RecordingError> {
        let Self { mut found, picture, .. } = self;
        if let (Some((folder, number)), Some((rgb, (height, width)))) = (pictures, picture)
            && let Ok(jpeg) = encode_jpeg(&rgb, height, width, QUALITY)
        {
            let name = file_name(topic, number);
            let path = folder.join(&name);
            std::fs::write(&path, jpeg).map_err(|source| RecordingError::Io { path, source })?;
            found.picture = Some(name);
        }
        Ok(found)
    }
}

/// Topics are untrusted: a file name has their letters and digits only, and a number that makes it unique.
fn file_name(topic: &str, number: usize) -> String {
    let plain = topic.trim_matches('/').chars().take(MAX_NAME);
    let plain: String = plain.map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).collect();
    format!("{number:03}_{plain}.jpg")
}

fn describe(message: &Value<'_>, limits: &Limits) -> Result<Described, RecordingError> {
    let described = if let Some(encoding) = picture::layout(message) {
        let side = |name| message.number(name).and_then(picture::whole).unwrap_or_default();
        let depth = matches!(encoding, "16UC1" | "mono16" | "32FC1");
        Described { depth, encoding: encoding.to_owned(), size: (side("height"), side("width")) }
    } else {
        let Header { codec, size, depth } = picture::header(message)?;
        Described { depth, encoding: codec.to_owned(), size }
    };
    let (height, width) = described.size;
    let pixels = u64::from(height) * u64::from(width);
    if pixels == 0 || pixels > limits.image_pixels {
        let problem = format!("the image has {height}×{width} pixels, at most {} are read", limits.image_pixels);
        return Err(RecordingError::BrokenImage { problem });
    }
    Ok(described)
}

/// The pixels as 8-bit RGB; the distances of depth are stretched over the grays.
fn rgb(message: &Value<'_>, depth: bool, (height, width): (u32, u32)) -> Result<Vec<u8>, RecordingError> {
    let camera = CameraSpec { name: String::new(), height, width, depth, recorded: None };
    if !depth {
        return picture::decode(message, Channel::Color, &camera);
    }
    let bytes = picture::decode(message, Channel::Depth, &camera)?;
    let depths: Vec<u16> = bytes.as_chunks().0.iter().map(|&pair| u16::from_le_bytes(pair)).collect();
    // 0 means no reading.
    let known = || depths.iter().copied().filter(|&depth| depth > 0);
    let (least, most) = (known().min().unwrap_or_default(), known().max().unwrap_or_default());
    let span = u32::from(most - least).max(1);
    let gray = |depth: u16| {
        let level = u32::from(depth.saturating_sub(least)) * 255 / span;
        u8::try_from(255 - level.min(255)).unwrap_or_default()
    };
    Ok(depths.iter().flat_map(|&depth| [if depth == 0 { 0 } else { gray(depth) }; 3]).collect())
}
