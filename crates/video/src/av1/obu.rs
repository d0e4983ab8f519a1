//! The units of an AV1 stream (OBUs), and the fields of their headers that are needed before decoding.

use rusty_h265::bits::{BitReader, OutOfData};

use crate::error::VideoError;

/// A unit.
pub(super) enum Obu<'a> {
    /// A sequence header.
    Sequence(&'a [u8]),
    /// A frame, or the header of one.
    Frame(&'a [u8]),
    /// Another unit.
    Other,
}

/// The units of a message.
pub(super) fn obus(data: &[u8]) -> Result<Vec<Obu<'_>>, VideoError> {
    let (mut rest, mut found) = (data, Vec::new());
    while let Some((&header, after)) = rest.split_first() {
        // The forbidden bit and the reserved bit are 0.
        if header & 0x81 != 0 {
            return Err(foreign());
        }
        let (extended, sized) = (header & 4 != 0, header & 2 != 0);
        let after = after.get(usize::from(extended)..).ok_or_else(foreign)?;
        let (size, after) = if sized { length(after).ok_or_else(foreign)? } else { (after.len(), after) };
        let (body, after) = after.split_at_checked(size).ok_or_else(foreign)?;
        found.push(match (header >> 3) & 0xf {
            1 => Obu::Sequence(body),
            3 | 6 => Obu::Frame(body),
            _ => Obu::Other,
        });
        rest = after;
    }
    if found.is_empty() { Err(foreign()) } else { Ok(found) }
}

fn foreign() -> VideoError {
    VideoError::damaged("the bytes are not whole units of AV1; record each temporal unit as a sequence of OBUs")
}

/// A length in groups of seven bits, least first.
fn length(bytes: &[u8]) -> Option<(usize, &[u8])> {
    let mut value = 0_u64;
    for (at, byte) in bytes.iter().take(8).enumerate() {
        value |= u64::from(byte & 0x7f) << (7 * at);
        if byte & 0x80 == 0 {
            return Some((usize::try_from(value).ok()?, bytes.get(at + 1..)?));
        }
    }
    None
}

/// Whether a sequence header is reduced to that of a still picture.
pub(super) fn is_still(sequence: &[u8]) -> bool {
    sequence.first().is_some_and(|byte| byte & 0x08 != 0)
}

/// Whether a frame is a key frame.
pub(super) fn is_key(frame: &[u8], still: bool) -> bool {
    // show_existing_frame, then two bits of the frame's type, of which 0 is a key frame.
    still || frame.first().is_some_and(|byte| byte & 0xe0 == 0)
}

/// Whether a frame is shown.
pub(super) fn is_shown(frame: &[u8], still: bool) -> bool {
    // show_existing_frame is the first bit, show_frame the fourth.
    still || frame.first().is_some_and(|byte| byte & 0x90 != 0)
}

/// A sequence header, as far as the size of its frames.
pub(super) struct Sequence {
    /// (height, width) of its largest frame.
    size: (u32, u32),
}

impl Sequence {
    pub(super) fn parse(body: &[u8]) -> Result<Self, VideoError> {
        let read = || -> Result<Self, OutOfData> {
            let mut bits = BitReader::new(body);
            bits.skip_bits(4)?;
            if bits.read_flag()? {
                bits.skip_bits(5)?;
            } else {
                operating_points(&mut bits)?;
            }
            let (width_bits, height_bits) = (bits.read_bits(4)? + 1, bits.read_bits(4)? + 1);
            let (width, height) = (bits.read_bits(width_bits)? + 1, bits.read_bits(height_bits)? + 1);
            Ok(Self { size: (height, width) })
        };
        read().map_err(|_| VideoError::damaged("AV1: the sequence header ends early; check the recorder's connection"))
    }

    /// Compares the size with that of the camera.
    pub(super) fn check(&self, (height, width): (u32, u32)) -> Result<(), VideoError> {
        if self.size == (height, width) {
            return Ok(());
        }
        Err(VideoError::WrongSize { height, width, found_height: self.size.0, found_width: self.size.1 })
    }
}

/// Skips times, the decoder's model and the operating points.
fn operating_points(bits: &mut BitReader<'_>) -> Result<(), OutOfData> {
    let mut delay_bits = None;
    if bits.read_flag()? {
        bits.skip_bits(32)?;
        bits.skip_bits(32)?;
        if bits.read_flag()? {
            bits.read_ue()?;
        }
        if bits.read_flag()? {
            delay_bits = Some(bits.read_bits(5)? + 1);
            bits.skip_bits(32)?;
            bits.skip_bits(10)?;
        }
    }
    let display_delays = bits.read_flag()?;
    for _ in 0..=bits.read_bits(5)? {
        bits.skip_bits(12)?;
        // Levels above 3.3 have a tier.
        if bits.read_bits(5)? > 7 {
            bits.skip_bits(1)?;
        }
        if let Some(delay_bits) = delay_bits
            && bits.read_flag()?
        {
            bits.skip_bits(delay_bits)?;
            bits.skip_bits(delay_bits)?;
            bits.skip_bits(1)?;
        }
        if display_delays && bits.read_flag()? {
            bits.skip_bits(4)?;
        }
    }
    Ok(())
}
