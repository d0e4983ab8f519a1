//! The beginning of a frame header of AV1 (AV1 specification, 5.9.2).

use rusty_h265::bits::{BitReader, OutOfData};

use super::sequence::Syntax;

const KEY: u32 = 0;
const INTRA_ONLY: u32 = 2;
const SWITCH: u32 = 3;
const EVERY_SLOT: u32 = 0xff;

/// A frame header.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Frame {
    /// Shows a frame that was decoded before, by its slot.
    Again(usize),
    /// Begins a frame.
    New {
        key: bool,
        shown: bool,
        /// The least bits of the frame's place in the order of presentation.
        hint: u32,
        /// A bit for each slot in which the frame is kept.
        slots: u32,
    },
}

/// Whether a frame is a key frame that is shown. One that is shown later does not begin a group of pictures: those that
/// are shown before it may depend on pictures before it.
pub(super) fn is_key(frame: &[u8], still: bool) -> bool {
    // show_existing_frame, two bits of the frame's type, of which 0 is a key frame, and show_frame.
    still || frame.first().is_some_and(|byte| byte & 0xf0 == 0x10)
}

/// Whether a frame is shown.
pub(super) fn is_shown(frame: &[u8], still: bool) -> bool {
    // show_existing_frame is the first bit, show_frame the fourth.
    still || frame.first().is_some_and(|byte| byte & 0x90 != 0)
}

impl Frame {
    pub(super) fn parse(body: &[u8], syntax: &Syntax) -> Result<Self, OutOfData> {
        let mut bits = BitReader::new(body);
        if bits.read_flag()? {
            return Ok(Self::Again(bits.read_bits(3)?.try_into().unwrap_or_default()));
        }
        let (kind, shown) = (bits.read_bits(2)?, bits.read_flag()?);
        let (key, intra) = (kind == KEY, kind == KEY || kind == INTRA_ONLY);
        let (begins, switches) = (key && shown, kind == SWITCH);
        if shown {
            bits.skip_bits(syntax.time_bits)?;
        } else {
            // Whether it can be shown later.
            bits.skip_bits(1)?;
        }
        let resilient = begins || switches || bits.read_flag()?;
        bits.skip_bits(1)?;
        let screen = if syntax.chooses_screen { bits.read_flag()? } else { syntax.screen };
        if screen && syntax.chooses_whole {
            bits.skip_bits(1)?;
        }
        bits.skip_bits(syntax.number_bits)?;
        if !switches {
            // Whether it has a size of its own.
            bits.skip_bits(1)?;
        }
        let hint = bits.read_bits(syntax.hint_bits)?;
        if !intra && !resilient {
            // The frame whose probabilities it continues.
            bits.skip_bits(3)?;
        }
        if let Some(removal_bits) = syntax.removal_bits
            && bits.read_flag()?
        {
            bits.skip_bits(removal_bits)?;
        }
        let slots = if begins || switches { EVERY_SLOT } else { bits.read_bits(8)? };
        Ok(Self::New { key, shown, hint, slots })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_frame_that_is_shown_later_begins_no_group() {
        let (shown, hidden, inter, again) = ([0x10], [0x00], [0x30], [0x98]);
        let key = |frame: &[u8]| (is_key(frame, false), is_shown(frame, false));
        assert_eq!(key(&shown), (true, true));
        assert_eq!(key(&hidden), (false, false));
        assert_eq!(key(&inter), (false, true));
        assert_eq!(key(&again), (false, true));
        assert!(is_key(&hidden, true) && is_shown(&hidden, true));
    }

    #[test]
    fn a_header_that_ends_early_is_an_error() {
        let syntax = Syntax {
            hint_bits: 7,
            number_bits: 15,
            chooses_screen: true,
            screen: false,
            chooses_whole: true,
            time_bits: 32,
            removal_bits: Some(32 * 32),
        };
        for length in 0..8 {
            assert_eq!(Frame::parse(&vec![0x10; length], &syntax), Err(OutOfData), "{length}");
        }
        assert_eq!(Frame::parse(&[0xd0], &syntax), Ok(Frame::Again(5)));
    }
}
