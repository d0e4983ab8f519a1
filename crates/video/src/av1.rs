//! AV1: pictures as they are shown, one temporal unit a message.
//!
//! The decoder does not report pictures that are missing before one; `order` finds them where the stream permits it.

mod frame;
mod obu;
mod order;
mod sequence;

use re_rav1d::pixel::{MatrixCoefficients, YUVRange};
use re_rav1d::{Decoder as Pictures, Error, PixelLayout, PlanarImageComponent, Settings};

use crate::decoder::{Decoded, Decoder};
use crate::error::VideoError;
use crate::glance::{Glance, Part};
use crate::picture::{Color, Picture, Plane};
use frame::Frame;
use obu::{Obu, obus};
use order::Order;
use sequence::{Sequence, Syntax};

/// Reads the headers of a message.
pub(crate) fn glance(data: &[u8]) -> Result<Glance, VideoError> {
    let mut glance = Glance { part: Part::None, pictures: 0, parameters: false };
    let mut still = false;
    for obu in obus(data)? {
        match obu {
            Obu::Sequence(body) => {
                glance.parameters = true;
                still = sequence::is_still(body);
            }
            Obu::Frame(body) => {
                let part = if frame::is_key(body, still) { Part::Key } else { Part::Follows };
                glance.part = if glance.part == Part::None { part } else { glance.part };
                glance.pictures += usize::from(frame::is_shown(body, still));
            }
            Obu::Other => {}
        }
    }
    Ok(glance)
}

/// A decoder of AV1.
pub(crate) struct Av1 {
    /// (height, width) of the camera.
    size: (u32, u32),
    pictures: Pictures,
    /// How the headers of frames are read, or why pictures are not decoded.
    sequence: Result<Option<Syntax>, VideoError>,
    order: Order,
}

impl Av1 {
    pub(crate) fn new(size: (u32, u32)) -> Result<Self, VideoError> {
        Ok(Self { size, pictures: Self::open(size)?, sequence: Ok(None), order: Order::default() })
    }

    fn open(size: (u32, u32)) -> Result<Pictures, VideoError> {
        let mut settings = Settings::new();
        // One thread and no delay: the picture of a message comes out with it.
        settings.set_n_threads(1);
        settings.set_max_frame_delay(1);
        settings.set_frame_size_limit(size.0.saturating_mul(size.1));
        Pictures::with_settings(&settings).map_err(failed)
    }

    /// Reads the headers of a message before it is decoded.
    fn check(&mut self, data: &[u8]) -> Result<(), VideoError> {
        let mut missing = false;
        for obu in obus(data)? {
            match obu {
                Obu::Sequence(body) => {
                    self.sequence = Sequence::parse(body).and_then(|sequence| sequence.check(self.size));
                }
                Obu::Frame(body) => {
                    let Some(syntax) = self.sequence.clone()? else { continue };
                    let frame = Frame::parse(body, &syntax)
                        .map_err(|_| VideoError::damaged("a header ends early; check the recorder's connection"))?;
                    missing |= self.order.misses(frame, &syntax);
                }
                Obu::Other => {}
            }
        }
        self.sequence.clone()?;
        if missing {
            return Err(VideoError::damaged("a picture before it is missing; check the recorder's connection"));
        }
        Ok(())
    }

    fn decode(&mut self, message: usize, data: &[u8], out: &mut Vec<Decoded>) -> Result<(), VideoError> {
        let stamp = i64::try_from(message).unwrap_or(i64::MAX);
        let mut sent = self.pictures.send_data(data.to_vec(), None, Some(stamp), None);
        self.take(out)?;
        while sent == Err(Error::Again) {
            let before = out.len();
            sent = self.pictures.send_pending_data();
            self.take(out)?;
            if sent == Err(Error::Again) && out.len() == before {
                return Err(VideoError::damaged("AV1: the decoder makes no progress"));
            }
        }
        sent.map_err(failed)
    }

    fn take(&mut self, out: &mut Vec<Decoded>) -> Result<(), VideoError> {
        loop {
            match self.pictures.get_picture() {
                Ok(found) => {
                    let message = found.timestamp().and_then(|message| usize::try_from(message).ok());
                    let picture = picture(&found)?;
                    let ((height, width), found) = (self.size, picture.size());
                    let side = |pixels: usize| u32::try_from(pixels).unwrap_or(u32::MAX);
                    let (found_height, found_width) = (side(found.0), side(found.1));
                    if (found_height, found_width) != self.size {
                        return Err(VideoError::WrongSize { height, width, found_height, found_width });
                    }
                    out.extend(message.map(|message| (message, picture)));
                }
                Err(Error::Again) => return Ok(()),
                Err(error) => return Err(failed(error)),
            }
        }
    }
}

impl Decoder for Av1 {
    fn push(&mut self, message: usize, data: &[u8], out: &mut Vec<Decoded>) -> Result<(), VideoError> {
        self.check(data)?;
        let before = out.len();
        if let Err(error) = self.decode(message, data, out) {
            // What the error left behind is dropped with the decoder.
            self.pictures = Self::open(self.size)?;
            return Err(error);
        }
        let (found, wanted) = (out.len() - before, glance(data)?.pictures);
        if found < wanted { Err(VideoError::damaged("AV1: the decoder returned no picture")) } else { Ok(()) }
    }

    fn parameters(&mut self, _: &[u8]) {
        // Each key frame has its sequence header.
    }

    fn flush(&mut self, _: &mut Vec<Decoded>) {
        // No picture is inside: there is no delay.
    }
}

fn picture(found: &re_rav1d::Picture) -> Result<Picture, VideoError> {
    let whole = |pixels: u32| usize::try_from(pixels).unwrap_or(usize::MAX);
    let (width, height) = (whole(found.width()), whole(found.height()));
    let wide = found.bit_depth() > 8;
    let plane = |component, width: usize, height: usize| {
        let (bytes, stride) = (found.plane(component), whole(found.stride(component)));
        let rows = bytes.chunks(stride.max(1)).take(height);
        let samples = if wide {
            rows.flat_map(|row| row.as_chunks().0.iter().take(width).map(|pair| u16::from_ne_bytes(*pair))).collect()
        } else {
            rows.flat_map(|row| row.iter().take(width).map(|&byte| byte.into())).collect()
        };
        Plane { width, height, samples }
    };
    let halves = match found.pixel_layout() {
        PixelLayout::I400 => None,
        PixelLayout::I420 => Some((width.div_ceil(2), height.div_ceil(2))),
        PixelLayout::I422 => Some((width.div_ceil(2), height)),
        PixelLayout::I444 => Some((width, height)),
    };
    let chroma = halves
        .map(|(width, height)| [PlanarImageComponent::U, PlanarImageComponent::V].map(|of| plane(of, width, height)));
    Ok(Picture {
        luma: plane(PlanarImageComponent::Y, width, height),
        chroma,
        depth: u8::try_from(found.bit_depth()).unwrap_or(8),
        color: Color::coded(matrix(found.matrix_coefficients()), found.color_range() == YUVRange::Full)?,
        order: found.timestamp().unwrap_or_default(),
    })
}

/// The code of a matrix.
fn matrix(of: MatrixCoefficients) -> u8 {
    const CODES: [(MatrixCoefficients, u8); 8] = [
        (MatrixCoefficients::Identity, 0),
        (MatrixCoefficients::BT709, 1),
        (MatrixCoefficients::Unspecified, 2),
        (MatrixCoefficients::BT470M, 4),
        (MatrixCoefficients::BT470BG, 6),
        (MatrixCoefficients::ST170M, 6),
        (MatrixCoefficients::ST240M, 7),
        (MatrixCoefficients::BT2020NonConstantLuminance, 9),
    ];
    CODES.iter().find(|(matrix, _)| *matrix == of).map_or(u8::MAX, |(_, code)| *code)
}

fn failed(error: Error) -> VideoError {
    if error == Error::UnsupportedBitstream {
        return VideoError::Unsupported("AV1 of this profile is not decoded; encode with the profile Main".to_owned());
    }
    VideoError::damaged(format!("AV1: {error}; check the recorder's connection"))
}
