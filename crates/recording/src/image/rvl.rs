//! Depth in RVL, a compression without loss that ROS's `compressedDepth` offers beside PNG: in turn a run of zeros and a
//! run of differences, as numbers of three bits a nibble (Wilson, "Fast Lossless Depth Image Compression", 2017).

use gleaner_core::PictureSizes;

use super::{broken, fit};
use crate::error::RecordingError;

/// Bits of a number in a nibble; the fourth says that another nibble follows.
const BITS: u32 = 3;
const MORE: u32 = 1 << BITS;
/// The longest number, more than any image of 32-bit sides within the limits has pixels.
const LONGEST: u32 = 30;

/// The (height, width) that precede the compressed values.
///
/// # Errors
/// [`RecordingError::BrokenImage`] when the bytes end before.
pub(super) fn size(bytes: &[u8]) -> Result<(u32, u32), RecordingError> {
    let side = |at: usize| bytes.get(at..at + 4).and_then(|side| side.try_into().ok()).map(u32::from_le_bytes);
    let (width, height) =
        side(0).zip(side(4)).ok_or_else(|| broken("the RVL ends before its size; record it again"))?;
    Ok((height, width))
}

/// The 16-bit values of an image, row by row, and its (height, width), which is checked before memory is reserved.
///
/// # Errors
/// [`RecordingError::WrongSize`] or [`RecordingError::BrokenImage`].
pub(super) fn values(bytes: &[u8], sizes: &PictureSizes) -> Result<(Vec<u16>, (u32, u32)), RecordingError> {
    let found = size(bytes)?;
    fit::check_size(sizes, found)?;
    let length = usize::try_from(u64::from(found.0) * u64::from(found.1));
    let length = length.map_err(|_| broken("the image is too large for this machine"))?;
    let mut nibbles = Nibbles { words: bytes.get(8..).unwrap_or_default().as_chunks().0.iter(), word: 0, left: 0 };
    let mut values: Vec<u16> = Vec::with_capacity(length);
    let mut previous = 0_u16;
    while values.len() < length {
        let ended =
            |values: &[u16]| broken(format!("the RVL ends after {} of {length} pixels; record it again", values.len()));
        let run = |values: &[u16], run: Option<u32>| {
            let run = run.and_then(|run| usize::try_from(run).ok()).ok_or_else(|| ended(values))?;
            let beyond = || broken(format!("a run of the RVL goes beyond its {length} pixels; record it again"));
            if run > length - values.len() { Err(beyond()) } else { Ok(run) }
        };
        let zeros = run(&values, nibbles.number())?;
        values.resize(values.len() + zeros, 0);
        for _ in 0..run(&values, nibbles.number())? {
            let number = nibbles.number().ok_or_else(|| ended(&values))?;
            // The lowest bit is the sign. Values wrap at 16 bits, as those of encoders do.
            let [low, high, ..] = ((number >> 1) ^ (number & 1).wrapping_neg()).to_le_bytes();
            previous = previous.wrapping_add(u16::from_le_bytes([low, high]));
            values.push(previous);
        }
    }
    Ok((values, found))
}

/// The nibbles of 32-bit words, the highest first.
struct Nibbles<'a> {
    words: std::slice::Iter<'a, [u8; 4]>,
    word: u32,
    /// Nibbles of the word that are left.
    left: u32,
}

impl Nibbles<'_> {
    fn next(&mut self) -> Option<u32> {
        if self.left == 0 {
            (self.word, self.left) = (u32::from_le_bytes(*self.words.next()?), 8);
        }
        let nibble = self.word >> 28;
        (self.word, self.left) = (self.word << 4, self.left - 1);
        Some(nibble)
    }

    /// The next number; `None` if the words end within it or it is too long.
    fn number(&mut self) -> Option<u32> {
        let (mut number, mut shift) = (0, 0);
        loop {
            let nibble = self.next()?;
            number |= (nibble & (MORE - 1)) << shift;
            shift += BITS;
            if nibble & MORE == 0 {
                return Some(number);
            }
            if shift >= LONGEST {
                return None;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What the reference implementation (the Python package `rvl` 1.0.4) makes of [`VALUES`].
    const COMPRESSED: [u8; 20] = [
        0x23, 0xf1, 0x8d, 0x33, 0x41, 0xf1, 0xfc, 0x22, 0x08, 0x40, 0xbd, 0x5e, 0x41, 0xf4, 0xfa, 0x93, 0x00, 0x00,
        0x13, 0x98,
    ];
    const VALUES: [u16; 24] =
        [0, 0, 0, 500, 501, 499, 0, 0, 65535, 1, 0, 1200, 1200, 1200, 1300, 40, 0, 0, 0, 0, 7, 0, 0, 0];

    fn image(height: u32, width: u32, words: &[u8]) -> Vec<u8> {
        [&width.to_le_bytes()[..], &height.to_le_bytes(), words].concat()
    }

    #[test]
    fn values_are_those_of_the_reference_implementation() {
        let found = values(&image(4, 6, &COMPRESSED), &PictureSizes::new(4, 6)).unwrap();
        assert_eq!(found, (VALUES.to_vec(), (4, 6)));
        // 24 zeros: one run of them, and one of no differences.
        let zeros = values(&image(4, 6, &[0, 0, 0, 0x83]), &PictureSizes::new(4, 6)).unwrap();
        assert_eq!(zeros.0, [0; 24]);
        // Without a zero.
        let ramp = [
            0xa9, 0x91, 0x2a, 0x1f, 0x1a, 0xa9, 0x91, 0x1a, 0x91, 0x1a, 0xa9, 0x91, 0xa9, 0x91, 0x1a, 0xa9, 0x1a, 0xa9,
            0x91, 0x1a, 0x91, 0x1a, 0xa9, 0x91, 0xa9, 0x91, 0x1a, 0xa9, 0x1a, 0xa9, 0x91, 0x1a, 0x91, 0x1a, 0xa9, 0x91,
        ];
        let found = values(&image(2, 12, &ramp), &PictureSizes::new(2, 12)).unwrap().0;
        assert_eq!(found, (0..24).map(|at| at * 37).collect::<Vec<u16>>());
    }

    #[test]
    fn a_truncated_image_is_refused_at_every_length() {
        let whole = image(4, 6, &COMPRESSED);
        for length in 0..whole.len() {
            let error = values(&whole[..length], &PictureSizes::new(4, 6)).unwrap_err().to_string();
            assert!(error.contains("the RVL ends"), "{length}: {error}");
        }
    }

    #[test]
    fn sizes_and_runs_that_cannot_be_are_refused() {
        let sizes = PictureSizes::new(4, 6);
        let wrong = values(&image(6, 4, &COMPRESSED), &sizes).unwrap_err();
        assert!(matches!(wrong, RecordingError::WrongSize { height: 4, width: 6, found_height: 6, found_width: 4 }));
        let vast = values(&image(u32::MAX, u32::MAX, &COMPRESSED), &sizes).unwrap_err();
        assert!(matches!(vast, RecordingError::WrongSize { .. }));
        let problem = |words: &[u8]| values(&image(4, 6, words), &sizes).unwrap_err().to_string();
        // Nibbles 9 3: a run of 25.
        assert!(problem(&[0, 0, 0, 0x93]).contains("beyond its 24 pixels"));
        // A number without an end.
        assert!(problem(&[0xff; 40]).contains("the RVL ends after 0 of 24"));
        // Runs of nothing.
        assert!(problem(&[0; 400]).contains("the RVL ends after 0 of 24"));
    }
}
