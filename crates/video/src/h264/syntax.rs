//! The fields of parameter sets and slice headers that a decoder's caller needs (ITU-T H.264, 7.3.2 and 7.3.3).

use rusty_h265::bits::{BitReader, OutOfData};

use crate::error::VideoError;
use crate::picture::Color;

/// A sequence parameter set.
#[derive(Clone, Copy, Debug)]
pub(super) struct SequenceSet {
    pub(super) id: u32,
    frame_num_bits: u32,
    /// Whether no picture is a field.
    frames_only: bool,
    /// Whether `frame_num` may skip values.
    pub(super) gaps: bool,
    /// Pixels as they are coded.
    coded: (u64, u64),
    /// Pixels that are cropped.
    cropped: (u64, u64),
    color: (u8, bool),
}

/// A picture parameter set.
#[derive(Clone, Copy, Debug)]
pub(super) struct PictureSet {
    pub(super) id: u32,
    pub(super) sequence: u32,
    pub(super) cabac: bool,
}

/// The beginning of a slice header.
#[derive(Clone, Copy, Debug)]
pub(super) struct Slice {
    /// Whether it begins a picture.
    pub(super) first: bool,
    pub(super) frame_num: u32,
    /// Whether its picture is a field, which has every second row of a frame.
    pub(super) field: bool,
}

/// Profiles whose sequence parameter sets describe chroma and scaling.
const HIGH: [u32; 13] = [100, 110, 122, 244, 44, 83, 86, 118, 128, 138, 139, 134, 135];

impl SequenceSet {
    pub(super) fn parse(body: &[u8]) -> Result<Self, OutOfData> {
        let mut bits = BitReader::new(body);
        let profile = bits.read_bits(8)?;
        bits.skip_bits(16)?;
        let id = bits.read_ue()?;
        let mut chroma = 1;
        if HIGH.contains(&profile) {
            chroma = bits.read_ue()?;
            if chroma == 3 {
                bits.read_flag()?;
            }
            bits.read_ue()?;
            bits.read_ue()?;
            bits.read_flag()?;
            if bits.read_flag()? {
                scaling_lists(&mut bits, if chroma == 3 { 12 } else { 8 })?;
            }
        }
        let frame_num_bits = bits.read_ue()?.saturating_add(4).min(16);
        presentation(&mut bits)?;
        bits.read_ue()?;
        let gaps = bits.read_flag()?;
        let (columns, rows) = (u64::from(bits.read_ue()?) + 1, u64::from(bits.read_ue()?) + 1);
        let frames_only = bits.read_flag()?;
        if !frames_only {
            bits.read_flag()?;
        }
        bits.read_flag()?;
        let fields = if frames_only { 1 } else { 2 };
        let units = match chroma {
            1 => (2, 2 * fields),
            2 => (2, fields),
            _ => (1, fields),
        };
        let mut cropped = (0, 0);
        if bits.read_flag()? {
            let [left, right, top, bottom] =
                [bits.read_ue()?, bits.read_ue()?, bits.read_ue()?, bits.read_ue()?].map(u64::from);
            cropped = ((top + bottom) * units.1, (left + right) * units.0);
        }
        let color = if bits.read_flag()? { color(&mut bits)? } else { (2, false) };
        let coded = (rows * 16 * fields, columns * 16);
        Ok(Self { id, frame_num_bits, frames_only, gaps, coded, cropped, color })
    }

    /// The number of values of `frame_num`.
    pub(super) fn frame_numbers(&self) -> u32 {
        1 << self.frame_num_bits
    }

    pub(super) fn color(&self) -> Result<Color, VideoError> {
        Color::coded(self.color.0, self.color.1)
    }

    /// Compares the size with that of the camera.
    pub(super) fn check(&self, (height, width): (u32, u32)) -> Result<(), VideoError> {
        let found = (self.coded.0.saturating_sub(self.cropped.0), self.coded.1.saturating_sub(self.cropped.1));
        // Cropping hides at most a macroblock in a stream of this size; more would be memory without a use.
        let hidden = |coded: u64, shown: u32| coded.saturating_sub(shown.into()) < 32;
        let fits = hidden(self.coded.0, height) && hidden(self.coded.1, width);
        if found == (height.into(), width.into()) && fits {
            return Ok(());
        }
        let side = |pixels| u32::try_from(pixels).unwrap_or(u32::MAX);
        let found = if found == (height.into(), width.into()) { self.coded } else { found };
        Err(VideoError::WrongSize { height, width, found_height: side(found.0), found_width: side(found.1) })
    }
}

impl PictureSet {
    pub(super) fn parse(body: &[u8]) -> Result<Self, OutOfData> {
        let mut bits = BitReader::new(body);
        Ok(Self { id: bits.read_ue()?, sequence: bits.read_ue()?, cabac: bits.read_flag()? })
    }
}

impl Slice {
    /// The id of the picture parameter set of a slice.
    pub(super) fn set(body: &[u8]) -> Result<u32, OutOfData> {
        let mut bits = BitReader::new(body);
        bits.read_ue()?;
        bits.read_ue()?;
        bits.read_ue()
    }

    pub(super) fn parse(body: &[u8], sequence: &SequenceSet) -> Result<Self, OutOfData> {
        let mut bits = BitReader::new(body);
        let first = bits.read_ue()? == 0;
        bits.read_ue()?;
        bits.read_ue()?;
        let frame_num = bits.read_bits(sequence.frame_num_bits)?;
        Ok(Self { first, frame_num, field: !sequence.frames_only && bits.read_flag()? })
    }
}

/// Skips the fields of the order of presentation.
fn presentation(bits: &mut BitReader<'_>) -> Result<(), OutOfData> {
    match bits.read_ue()? {
        0 => {
            bits.read_ue()?;
        }
        1 => {
            bits.read_flag()?;
            bits.read_se()?;
            bits.read_se()?;
            for _ in 0..bits.read_ue()?.min(255) {
                bits.read_se()?;
            }
        }
        _ => {}
    }
    Ok(())
}

fn scaling_lists(bits: &mut BitReader<'_>, lists: usize) -> Result<(), OutOfData> {
    for list in 0..lists {
        if !bits.read_flag()? {
            continue;
        }
        let (mut last, mut next) = (8, 8);
        for _ in 0..if list < 6 { 16 } else { 64 } {
            if next != 0 {
                next = (last + bits.read_se()?).rem_euclid(256);
            }
            last = if next == 0 { last } else { next };
        }
    }
    Ok(())
}

/// The matrix and whether the range is full, from the usability information.
fn color(bits: &mut BitReader<'_>) -> Result<(u8, bool), OutOfData> {
    const FREE_ASPECT: u32 = 255;
    if bits.read_flag()? && bits.read_bits(8)? == FREE_ASPECT {
        bits.skip_bits(32)?;
    }
    if bits.read_flag()? {
        bits.read_flag()?;
    }
    let (mut matrix, mut full_range) = (2, false);
    if bits.read_flag()? {
        bits.skip_bits(3)?;
        full_range = bits.read_flag()?;
        if bits.read_flag()? {
            bits.skip_bits(16)?;
            matrix = bits.read_bits(8)?;
        }
    }
    Ok((u8::try_from(matrix).unwrap_or(u8::MAX), full_range))
}
