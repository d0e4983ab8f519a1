//! The sequence header of AV1: the size of its frames, and the fields on which the headers of frames depend (AV1
//! specification, 5.5).

use rusty_h265::bits::{BitReader, OutOfData};

use crate::error::VideoError;

/// A choice that each frame header makes.
const IN_EACH_FRAME: u32 = 2;

/// Whether a sequence header is reduced to that of a still picture.
pub(super) fn is_still(sequence: &[u8]) -> bool {
    sequence.first().is_some_and(|byte| byte & 0x08 != 0)
}

/// A sequence header.
pub(super) struct Sequence {
    /// (height, width) of its largest frame.
    size: (u32, u32),
    syntax: Option<Syntax>,
}

/// What it takes to read the headers of frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Syntax {
    /// Bits of an order hint, 1 to 8.
    pub(super) hint_bits: u32,
    /// Bits of a frame's number; 0 without numbers.
    pub(super) number_bits: u32,
    /// Whether each frame header chooses the tools for screen content.
    pub(super) chooses_screen: bool,
    /// Whether frames use the tools for screen content, unless each chooses.
    pub(super) screen: bool,
    /// Whether each frame header with these tools chooses whole motion vectors.
    pub(super) chooses_whole: bool,
    /// Bits of the time at which a frame is shown; 0 without times.
    pub(super) time_bits: u32,
    /// Bits of the times at which buffers are removed, one time for each operating point with a model.
    pub(super) removal_bits: Option<u32>,
}

/// The times of a stream and its operating points.
#[derive(Default)]
struct Timing {
    time_bits: u32,
    removal_bits: Option<u32>,
    /// Whether the stream has layers, of which some can be left out.
    layered: bool,
}

impl Sequence {
    pub(super) fn parse(body: &[u8]) -> Result<Self, VideoError> {
        Self::read(body)
            .map_err(|_| VideoError::damaged("AV1: the sequence header ends early; check the recorder's connection"))
    }

    fn read(body: &[u8]) -> Result<Self, OutOfData> {
        let mut bits = BitReader::new(body);
        bits.skip_bits(4)?;
        let still = bits.read_flag()?;
        let timing = if still {
            bits.skip_bits(5)?;
            Timing::default()
        } else {
            Timing::read(&mut bits)?
        };
        let (width_bits, height_bits) = (bits.read_bits(4)? + 1, bits.read_bits(4)? + 1);
        let (width, height) = (bits.read_bits(width_bits)? + 1, bits.read_bits(height_bits)? + 1);
        let syntax = if still || timing.layered { None } else { Syntax::read(&mut bits, &timing)? };
        Ok(Self { size: (height, width), syntax })
    }

    /// Compares the size with that of the camera; returns how the headers of frames are read, of a stream without layers
    /// whose frames have order hints.
    pub(super) fn check(&self, (height, width): (u32, u32)) -> Result<Option<Syntax>, VideoError> {
        if self.size == (height, width) {
            return Ok(self.syntax);
        }
        Err(VideoError::WrongSize { height, width, found_height: self.size.0, found_width: self.size.1 })
    }
}

impl Syntax {
    fn read(bits: &mut BitReader<'_>, timing: &Timing) -> Result<Option<Self>, OutOfData> {
        let numbered = bits.read_flag()?;
        // The second length is what a number has beyond a difference, of which the first is the length.
        let number_bits = if numbered { bits.read_bits(4)? + 2 + bits.read_bits(3)? + 1 } else { 0 };
        // Superblocks, and the tools of intra and inter prediction.
        bits.skip_bits(3 + 4)?;
        let hinted = bits.read_flag()?;
        if hinted {
            bits.skip_bits(2)?;
        }
        let screen = if bits.read_flag()? { IN_EACH_FRAME } else { bits.read_bits(1)? };
        let whole = if screen == 0 || bits.read_flag()? { IN_EACH_FRAME } else { bits.read_bits(1)? };
        if !hinted {
            return Ok(None);
        }
        Ok(Some(Self {
            hint_bits: bits.read_bits(3)? + 1,
            number_bits,
            chooses_screen: screen == IN_EACH_FRAME,
            screen: screen == 1,
            chooses_whole: whole == IN_EACH_FRAME,
            time_bits: timing.time_bits,
            removal_bits: timing.removal_bits,
        }))
    }
}

impl Timing {
    /// Reads times, the decoder's model and the operating points.
    fn read(bits: &mut BitReader<'_>) -> Result<Self, OutOfData> {
        let mut timing = Self::default();
        let mut delay_bits = None;
        if bits.read_flag()? {
            bits.skip_bits(32)?;
            bits.skip_bits(32)?;
            let equal_intervals = bits.read_flag()?;
            if equal_intervals {
                bits.read_ue()?;
            }
            if bits.read_flag()? {
                delay_bits = Some(bits.read_bits(5)? + 1);
                bits.skip_bits(32)?;
                timing.removal_bits = Some(bits.read_bits(5)? + 1);
                let time_bits = bits.read_bits(5)? + 1;
                timing.time_bits = if equal_intervals { 0 } else { time_bits };
            }
        }
        let (display_delays, mut models) = (bits.read_flag()?, 0);
        for _ in 0..=bits.read_bits(5)? {
            timing.layered |= bits.read_bits(12)? != 0;
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
                models += 1;
            }
            if display_delays && bits.read_flag()? {
                bits.skip_bits(4)?;
            }
        }
        timing.removal_bits = timing.removal_bits.map(|bits| bits * models);
        Ok(timing)
    }
}
