//! The bytes of a message of video, and its codec.

use std::borrow::Cow;

use gleaner_video::{Codec, Format};

use crate::dialect::Value;
use crate::error::RecordingError;
use crate::picture;

/// What a message adds to a stream.
pub(crate) struct Packet<'a> {
    pub(crate) codec: Codec,
    pub(crate) data: Cow<'a, [u8]>,
}

/// The packet of a message; `None` if the message is an image. The error names a codec that is not decoded.
pub(crate) fn packet<'a>(message: &'a Value<'_>) -> Option<Result<Packet<'a>, RecordingError>> {
    // FFMPEGPacket names its codec where a raw image has its layout, and counts its frames.
    let encoding = message.text("encoding").filter(|_| message.number("pts").is_some());
    let name = encoding.or_else(|| message.text("format").filter(|_| message.text("encoding").is_none()))?;
    let broken = |problem: String| Some(Err(RecordingError::BrokenImage { problem }));
    match Format::named(name) {
        Format::Video(codec) => Some(picture::data(message).map(|data| Packet { codec, data })),
        Format::Undecoded(error) => broken(error.to_string()),
        Format::Other if encoding.is_some() => {
            broken(format!("video of the encoding `{name}` is not decoded; record or convert it as h264, h265 or av1"))
        }
        Format::Other => None,
    }
}
