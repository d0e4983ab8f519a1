//! The pictures of one camera, message by message.

use gleaner_core::CameraSpec;
use gleaner_video::{Outcome, Picture, Stream, VideoError};

use super::packet::Packet;
use crate::error::RecordingError;
use crate::image::fit;

/// The decoder of a camera's topic. It needs every message of the topic in order, also those without a step.
#[derive(Default)]
pub(crate) struct Video {
    stream: Option<Stream>,
    /// The last whole picture.
    last: Option<Picture>,
}

/// What a message shows.
pub(crate) struct Shown {
    /// Index of the message in the topic.
    pub(crate) message: usize,
    /// The pixels of a step: of its own picture, or of the last whole one if its own is damaged.
    pub(crate) pixels: Result<Vec<u8>, RecordingError>,
    /// Why they are those of the last whole picture.
    pub(crate) held: Option<RecordingError>,
}

impl Video {
    /// Decodes a message; returns what it and earlier messages show, as far as `used` is true of them.
    pub(crate) fn push(
        &mut self,
        message: usize,
        packet: &Packet<'_>,
        camera: &CameraSpec,
        used: &dyn Fn(usize) -> bool,
    ) -> Vec<Shown> {
        let mut shown = Vec::new();
        if self.stream.as_ref().is_none_or(|stream| stream.codec() != packet.codec) {
            shown = self.end(camera, used);
            match Stream::new(packet.codec, camera.sizes().recorded()) {
                Ok(stream) => self.stream = Some(stream),
                Err(error) => return vec![Shown { message, pixels: Err(convert(error)), held: None }],
            }
        }
        let outcomes = self.stream.as_mut().map(|stream| stream.push(message, &packet.data)).unwrap_or_default();
        shown.extend(self.show(outcomes, camera, used));
        shown
    }

    /// Ends the stream; returns what its last messages show.
    pub(crate) fn end(&mut self, camera: &CameraSpec, used: &dyn Fn(usize) -> bool) -> Vec<Shown> {
        let outcomes = self.stream.take().map(|mut stream| stream.end()).unwrap_or_default();
        self.show(outcomes, camera, used)
    }

    fn show(&mut self, outcomes: Vec<Outcome>, camera: &CameraSpec, used: &dyn Fn(usize) -> bool) -> Vec<Shown> {
        let mut shown = Vec::new();
        for Outcome { message, picture } in outcomes {
            let failure = match picture {
                Ok(picture) => {
                    self.last = Some(picture);
                    None
                }
                Err(error) => Some(error),
            };
            if !used(message) {
                continue;
            }
            let (pixels, held) = match (failure, &self.last) {
                (None, Some(picture)) => (pixels(picture, camera), None),
                (Some(error), Some(picture)) if error.passes() => (pixels(picture, camera), Some(convert(error))),
                (Some(error), _) => (Err(convert(error)), None),
                (None, None) => continue,
            };
            shown.push(Shown { message, pixels, held });
        }
        shown
    }
}

/// The pixels of a step.
fn pixels(picture: &Picture, camera: &CameraSpec) -> Result<Vec<u8>, RecordingError> {
    let (height, width) = picture.size();
    let side = |pixels: usize| u32::try_from(pixels).unwrap_or(u32::MAX);
    fit::color(picture.rgb(), (side(height), side(width)), &camera.sizes())
}

fn convert(error: VideoError) -> RecordingError {
    match error {
        VideoError::WrongSize { height, width, found_height, found_width } => {
            RecordingError::WrongSize { height, width, found_height, found_width }
        }
        VideoError::Unsupported(problem) | VideoError::Damaged(problem) => RecordingError::BrokenImage { problem },
        VideoError::Lost | VideoError::BeforeKey => RecordingError::BrokenImage { problem: error.to_string() },
    }
}
