//! A stream: which messages are decoded, and what becomes of those that can't be.
//!
//! Decoding begins at a key frame. After damage, pictures resume at the next key frame: those between could be shown, but
//! not as they were recorded.

use std::panic::{AssertUnwindSafe, catch_unwind};

use crate::av1::{self, Av1};
use crate::codec::Codec;
use crate::decoder::{Decoded, Decoder};
use crate::error::VideoError;
use crate::glance::{Glance, Part};
use crate::h264::{self, H264};
use crate::h265::{self, H265};
use crate::picture::Picture;

/// What became of a message with a picture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Outcome {
    /// The number of the message, as it was pushed.
    pub message: usize,
    /// Its picture, or the reason for its absence.
    pub picture: Result<Picture, VideoError>,
}

/// The decoder of one camera's messages.
pub struct Stream {
    codec: Codec,
    /// (height, width).
    size: (u32, u32),
    decoder: Box<dyn Decoder>,
    /// Why pictures that depend on others are not decoded.
    lost: Option<VideoError>,
    /// Whether the last key frame began without pictures before it.
    fresh: bool,
    /// Messages whose picture has not come out.
    open: Vec<Open>,
}

/// A message whose picture has not come out.
struct Open {
    message: usize,
    /// Pictures to come.
    pictures: usize,
    /// The last one so far.
    last: Option<Picture>,
}

impl Stream {
    /// Begins a stream whose pictures have height × width pixels.
    ///
    /// # Errors
    /// If the decoder can't be set up.
    pub fn new(codec: Codec, (height, width): (u32, u32)) -> Result<Self, VideoError> {
        let size = (height, width);
        let (decoder, open) = (decoder(codec, size)?, Vec::new());
        Ok(Self { codec, size, decoder, lost: Some(VideoError::BeforeKey), fresh: true, open })
    }

    /// The codec.
    pub fn codec(&self) -> Codec {
        self.codec
    }

    /// Decodes a message; returns what became of it and of earlier ones. Each message with a picture has one outcome, here
    /// or later. The picture of a message that holds several is the last that is shown.
    pub fn push(&mut self, message: usize, data: &[u8]) -> Vec<Outcome> {
        let mut out = Vec::new();
        let held = match glance(self.codec, data) {
            Ok(held) => held,
            Err(error) => {
                self.fail(message, error, &mut out);
                return out;
            }
        };
        let orphan = held.part == Part::Leading && self.fresh;
        if let Some(lost) = self.lost.clone().filter(|_| held.part != Part::Key) {
            if held.parameters {
                self.guarded(|decoder| decoder.parameters(data));
            }
            if held.pictures > 0 {
                out.push(Outcome { message, picture: Err(lost) });
            }
            return out;
        }
        if orphan {
            out.push(Outcome { message, picture: Err(VideoError::Lost) });
            return out;
        }
        if held.part == Part::Key {
            self.fresh = self.lost.take().is_some();
        }
        if held.pictures > 0 {
            self.open.push(Open { message, pictures: held.pictures, last: None });
        }
        let mut decoded = Vec::new();
        let pushed = self.guarded(|decoder| decoder.push(message, data, &mut decoded));
        self.settle(decoded, &mut out);
        if let Err(error) = pushed.unwrap_or_else(|| Err(VideoError::damaged("the decoder failed"))) {
            self.fail(message, error, &mut out);
        }
        out
    }

    /// Ends the stream; returns what became of the messages that are still open.
    pub fn end(&mut self) -> Vec<Outcome> {
        let mut out = Vec::new();
        self.flush(&mut out);
        out
    }

    /// Nothing after this message is decoded before the next key frame.
    fn fail(&mut self, message: usize, error: VideoError, out: &mut Vec<Outcome>) {
        self.open.retain(|open| open.message != message);
        self.flush(out);
        self.lost = Some(if error.passes() { VideoError::Lost } else { error.clone() });
        out.push(Outcome { message, picture: Err(error) });
    }

    fn flush(&mut self, out: &mut Vec<Outcome>) {
        let mut decoded = Vec::new();
        self.guarded(|decoder| decoder.flush(&mut decoded));
        self.settle(decoded, out);
        let open = self.open.drain(..);
        out.extend(open.map(|Open { message, last, .. }| Outcome { message, picture: last.ok_or(VideoError::Lost) }));
    }

    /// The outcomes of messages whose last picture came out.
    fn settle(&mut self, decoded: Vec<Decoded>, out: &mut Vec<Outcome>) {
        for (message, picture) in decoded {
            let Some(at) = self.open.iter().position(|open| open.message == message) else { continue };
            if let Some(open) = self.open.get_mut(at).filter(|open| open.pictures > 1) {
                open.pictures -= 1;
                open.last = Some(picture);
            } else {
                self.open.remove(at);
                out.push(Outcome { message, picture: Ok(picture) });
            }
        }
    }

    /// Runs the decoder; `None` if it panics, after which it begins again.
    fn guarded<T>(&mut self, work: impl FnOnce(&mut dyn Decoder) -> T) -> Option<T> {
        let inner = &mut self.decoder;
        let done = catch_unwind(AssertUnwindSafe(|| work(inner.as_mut())));
        if done.is_err()
            && let Ok(again) = decoder(self.codec, self.size)
        {
            self.decoder = again;
        }
        done.ok()
    }
}

fn decoder(codec: Codec, size: (u32, u32)) -> Result<Box<dyn Decoder>, VideoError> {
    Ok(match codec {
        Codec::H264 => Box::new(H264::new(size)),
        Codec::H265 => Box::new(H265::new(size)),
        Codec::Av1 => Box::new(Av1::new(size)?),
    })
}

/// Reads the headers of a message without decoding it.
///
/// # Errors
/// [`VideoError::Damaged`] if the bytes are not of the codec.
pub fn glance(codec: Codec, data: &[u8]) -> Result<Glance, VideoError> {
    match codec {
        Codec::H264 => h264::glance(data),
        Codec::H265 => h265::glance(data),
        Codec::Av1 => av1::glance(data),
    }
}
