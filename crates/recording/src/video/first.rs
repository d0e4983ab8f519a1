//! The size and the first picture of a video whose size is not known.

use gleaner_video::{Stream, VideoError};

use super::packet::Packet;
use crate::error::RecordingError;

/// Messages that are kept until a key frame shows the size: parameter sets may be messages of their own.
const MAX_KEPT: usize = 8;

/// Looks for the first key frame of a topic.
#[derive(Default)]
pub(crate) struct FirstPicture {
    kept: Vec<Vec<u8>>,
    done: bool,
}

/// (height, width), and the RGB of the picture if it is wanted and can be decoded.
pub(crate) type Found = ((u32, u32), Option<Vec<u8>>);

impl FirstPicture {
    /// Adds the next message; returns the size once, or the reason why it is not found.
    pub(crate) fn push(
        &mut self,
        packet: &Packet<'_>,
        most_pixels: u64,
        picture: bool,
    ) -> Option<Result<Found, RecordingError>> {
        if self.done {
            return None;
        }
        if self.kept.len() == MAX_KEPT {
            self.kept.remove(0);
        }
        self.kept.push(packet.data.to_vec());
        // No picture has one pixel, so the first key frame is an error that has its size.
        let error = match self.decode(packet, (1, 1)) {
            Ok(Err(error)) | Err(error) => error,
            Ok(Ok(_)) => return None,
        };
        let VideoError::WrongSize { found_height, found_width, .. } = error else {
            // Video may begin before its first key frame.
            return (!error.passes()).then(|| Err(broken(&error)));
        };
        self.done = true;
        let (size, pixels) = ((found_height, found_width), u64::from(found_height) * u64::from(found_width));
        if pixels > most_pixels {
            let problem = format!("the video has {found_height}×{found_width} pixels, at most {most_pixels} are read");
            return Some(Err(RecordingError::BrokenImage { problem }));
        }
        let picture = picture.then(|| self.decode(packet, size).ok()?.ok()).flatten();
        self.kept.clear();
        Some(Ok((size, picture)))
    }

    /// The RGB of the last picture of the kept messages as a video of this size; an error that does not pass comes first.
    fn decode(&self, packet: &Packet<'_>, size: (u32, u32)) -> Result<Result<Vec<u8>, VideoError>, VideoError> {
        let mut stream = Stream::new(packet.codec, size)?;
        let mut outcomes = Vec::new();
        for (at, data) in self.kept.iter().enumerate() {
            outcomes.extend(stream.push(at, data));
        }
        outcomes.extend(stream.end());
        let last = outcomes.into_iter().map(|outcome| outcome.picture).reduce(|before, next| match before {
            Err(error) if !error.passes() => Err(error),
            Ok(_) | Err(_) => next,
        });
        Ok(last.unwrap_or(Err(VideoError::BeforeKey)).map(|picture| picture.rgb()))
    }
}

fn broken(error: &VideoError) -> RecordingError {
    RecordingError::BrokenImage { problem: error.to_string() }
}
