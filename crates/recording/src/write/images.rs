//! Images into the recording: compressed ones and raw ones, each on a channel of its own of the camera's topic.
//!
//! A channel is made when its first image comes, so that a recording declares only what it holds.

use std::collections::BTreeMap;
use std::io::{Seek, Write};

use prost::Message as _;

use super::mapping::{color_topic, depth_topic};
use super::schema::{self, CompressedImage, RawImage};
use super::{EpisodeWriter, add_channel, timestamp};
use crate::error::RecordingError;
use crate::image::encode_jpeg;
use crate::picture::Channel;
use gleaner_core::CameraSpec;

const JPEG_QUALITY: u8 = 92;

/// The channels that there are, by camera, color (else depth) and compressed (else raw).
#[derive(Default)]
pub(super) struct ImageChannels(BTreeMap<(usize, bool, bool), u16>);

/// An image as it is kept.
#[derive(Clone, Copy)]
pub(super) enum Kept<'a> {
    /// A file of this format.
    Compressed(&'static str, &'a [u8]),
    /// The (height, width), and rows of RGB bytes or of 16-bit little-endian millimetres.
    Raw((u32, u32), &'a [u8]),
    /// The (height, width), and rows of 32-bit little-endian metres.
    Metres((u32, u32), &'a [u8]),
}

/// Rows of RGB as JPEG.
pub(super) fn jpeg(camera: &CameraSpec, rgb: &[u8]) -> Result<Vec<u8>, RecordingError> {
    encode_jpeg(rgb, camera.height, camera.width, JPEG_QUALITY)
}

impl<W: Write + Seek> EpisodeWriter<W> {
    /// Writes one image of a camera.
    pub(super) fn image(
        &mut self,
        at: usize,
        kind: Channel,
        stamp_ns: i64,
        image: Kept<'_>,
    ) -> Result<(), RecordingError> {
        let camera = &self.spec.cameras[at];
        let (color, compressed) = (kind == Channel::Color, matches!(image, Kept::Compressed(..)));
        let channel = match self.images.0.get(&(at, color, compressed)) {
            Some(&channel) => channel,
            None => {
                let topic = if color { color_topic(camera) } else { depth_topic(camera) };
                let schema = if compressed { schema::compressed_image() } else { schema::raw_image() };
                let channel = add_channel(&mut self.mcap, &topic, &schema)?;
                self.images.0.insert((at, color, compressed), channel);
                channel
            }
        };
        let (timestamp, frame_id) = (Some(timestamp(stamp_ns)), camera.name.clone());
        let bytes = match image {
            Kept::Compressed(format, data) => {
                CompressedImage { timestamp, data: data.to_vec(), format: format.to_owned(), frame_id }.encode_to_vec()
            }
            Kept::Raw((height, width), data) | Kept::Metres((height, width), data) => {
                let (encoding, pixel_bytes) = match image {
                    Kept::Metres(..) => ("32FC1", 4),
                    Kept::Raw(..) | Kept::Compressed(..) if color => ("rgb8", 3),
                    Kept::Raw(..) | Kept::Compressed(..) => ("16UC1", 2),
                };
                RawImage {
                    timestamp,
                    width,
                    height,
                    encoding: encoding.to_owned(),
                    step: width * pixel_bytes,
                    data: data.to_vec(),
                    frame_id,
                }
                .encode_to_vec()
            }
        };
        self.write(channel, stamp_ns, &bytes)
    }
}
