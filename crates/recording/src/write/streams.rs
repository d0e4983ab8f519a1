//! The streams of a step one by one, as other recorders made them: pictures of a camera, packets of its video, and the
//! proprioception. Nothing is coded again.

use std::io::{Seek, Write};

use mcap::records::MessageHeader;
use prost::Message as _;

use super::images::Kept;
use super::mapping::color_topic;
use super::observed::ImageRef;
use super::schema::{self, CompressedVideo};
use super::{EpisodeWriter, add_channel, timestamp};
use crate::error::RecordingError;
use crate::picture::Channel;

/// One message of a camera.
#[derive(Clone, Copy, Debug)]
pub enum CameraMessage<'a> {
    /// A color image.
    Color(ImageRef<'a>),
    /// A depth image.
    Depth(ImageRef<'a>),
    /// A depth image as rows of 32-bit little-endian metres.
    DepthMetres(&'a [u8]),
    /// A packet of video that holds one picture: H.264 or H.265 as Annex B, or a temporal unit of AV1.
    Video {
        /// `h264`, `h265` or `av1`.
        format: &'a str,
        /// The packet.
        data: &'a [u8],
    },
}

impl<W: Write + Seek> EpisodeWriter<W> {
    /// Writes a message of the camera with this number in the task. Images are kept byte for byte and are not decoded.
    /// Packets of video come in the order of decoding, with the stamps at which their pictures are shown.
    ///
    /// # Errors
    /// [`RecordingError::Step`] or `BrokenImage` if it does not fit the task; [`RecordingError::Write`].
    pub fn camera_message(
        &mut self,
        camera: usize,
        stamp_ns: i64,
        message: CameraMessage<'_>,
    ) -> Result<(), RecordingError> {
        self.check_stamp(stamp_ns)?;
        let Some(spec) = self.spec.cameras.get(camera) else {
            return Err(self.wrong(format!("the task has no camera {camera}")));
        };
        match message {
            CameraMessage::Color(image) => {
                let kept = self.kept(camera, Channel::Color, image)?;
                self.image(camera, Channel::Color, stamp_ns, kept)
            }
            CameraMessage::Depth(image) => {
                let kept = self.kept(camera, Channel::Depth, image)?;
                self.image(camera, Channel::Depth, stamp_ns, kept)
            }
            CameraMessage::DepthMetres(rows) => {
                let size = spec.sizes().recorded();
                let wanted = (size.0 as usize).saturating_mul(size.1 as usize).saturating_mul(4);
                self.check_size("depth", rows.len(), wanted)?;
                self.image(camera, Channel::Depth, stamp_ns, Kept::Metres(size, rows))
            }
            CameraMessage::Video { format, data } => self.packet(camera, stamp_ns, format, data),
        }
    }

    /// Writes the proprioception of a step; its action follows with [`EpisodeWriter::act`].
    ///
    /// # Errors
    /// [`RecordingError::Step`] if it does not fit the task, or [`RecordingError::Write`].
    pub fn sense(&mut self, stamp_ns: i64, proprioception: &[f32]) -> Result<(), RecordingError> {
        self.check_stamp(stamp_ns)?;
        self.check_numbers("proprioception", proprioception, self.spec.proprioception_size())?;
        self.state(stamp_ns, proprioception)
    }

    fn packet(&mut self, at: usize, stamp_ns: i64, format: &str, data: &[u8]) -> Result<(), RecordingError> {
        let camera = &self.spec.cameras[at];
        let message = CompressedVideo {
            timestamp: Some(timestamp(stamp_ns)),
            frame_id: camera.name.clone(),
            data: data.to_vec(),
            format: format.to_owned(),
        };
        let (channel_id, last) = match self.videos.get(&at) {
            Some(known) => *known,
            None => (add_channel(&mut self.mcap, &color_topic(camera), &schema::compressed_video())?, 0),
        };
        // Readers that sort by the time of logging must keep the order of decoding.
        let log_time = u64::try_from(stamp_ns).unwrap_or_default().max(last);
        self.videos.insert(at, (channel_id, log_time));
        let header = MessageHeader { channel_id, sequence: self.steps, log_time, publish_time: log_time };
        self.mcap.write_to_known_channel(&header, &message.encode_to_vec()).map_err(RecordingError::Write)
    }
}

#[cfg(test)]
mod tests;
