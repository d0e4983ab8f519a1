//! The compression of a picture: each row as its difference to the row above, then zstd. Lossless.
//!
//! The measurements behind the choice are in docs/decisions/0036-frames-are-cached-compressed.md.

use std::io;

use zstd::bulk::{Compressor, Decompressor};

/// The fastest level: higher ones gain less than 1 % on pictures.
const LEVEL: i32 = 1;

/// Compresses pictures one after the other; its memory is reused.
pub(crate) struct Packer {
    compressor: Compressor<'static>,
    differences: Vec<u8>,
    packed: Vec<u8>,
}

impl Packer {
    pub(crate) fn new() -> io::Result<Self> {
        Ok(Self { compressor: Compressor::new(LEVEL)?, differences: Vec::new(), packed: Vec::new() })
    }

    /// The packed bytes of a picture with rows of `row_bytes`, valid until the next call.
    pub(crate) fn pack(&mut self, pixels: &[u8], row_bytes: usize) -> io::Result<&[u8]> {
        self.differences.clear();
        self.differences.extend_from_slice(pixels.get(..row_bytes).unwrap_or(pixels));
        let below = pixels.iter().skip(row_bytes).zip(pixels);
        self.differences.extend(below.map(|(value, above)| value.wrapping_sub(*above)));
        self.packed.clear();
        self.packed.reserve(zstd::zstd_safe::compress_bound(pixels.len()));
        self.compressor.compress_to_buffer(&self.differences, &mut self.packed)?;
        Ok(&self.packed)
    }
}

/// Decompresses pictures one after the other; its memory is reused.
pub(super) struct Unpacker(Decompressor<'static>);

impl Unpacker {
    pub(super) fn new() -> io::Result<Self> {
        Ok(Self(Decompressor::new()?))
    }

    /// Fills `pixels`, a picture with rows of `row_bytes`.
    ///
    /// # Errors
    /// The reason why `packed` is no picture of this size.
    pub(super) fn unpack(&mut self, packed: &[u8], row_bytes: usize, pixels: &mut [u8]) -> Result<(), String> {
        match self.0.decompress_to_buffer(packed, pixels) {
            Ok(found) if found == pixels.len() => {}
            Ok(found) => return Err(format!("a picture unpacks to {found} bytes instead of {}", pixels.len())),
            Err(error) => return Err(format!("a picture cannot be unpacked ({error})")),
        }
        let mut rows = pixels.chunks_exact_mut(row_bytes.max(1));
        let Some(mut above) = rows.next() else { return Ok(()) };
        for row in rows {
            row.iter_mut().zip(above.iter()).for_each(|(value, above)| *value = value.wrapping_add(*above));
            above = row;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {

    use super::*;

    #[test]
    fn every_picture_comes_back_bit_for_bit() {
        let mut state = 1u32;
        let mut noise = |_| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            state.to_be_bytes()[0]
        };
        let noise: Vec<u8> = (0..16 * 16 * 3).map(&mut noise).collect();
        let slope: Vec<u8> = (0..16 * 48).map(|at| u8::try_from(at / 48 * 9 % 256).unwrap()).collect();
        let (mut packer, mut unpacker) = (Packer::new().unwrap(), Unpacker::new().unwrap());
        for (pixels, row_bytes) in [(&noise, 48), (&slope, 48), (&vec![255; 32], 32), (&vec![7, 9], 2)] {
            let packed = packer.pack(pixels, row_bytes).unwrap();
            assert!(packed.len() < pixels.len() + 32);
            let mut back = vec![1; pixels.len()];
            unpacker.unpack(packed, row_bytes, &mut back).unwrap();
            assert_eq!(back, *pixels);
        }
        assert!(packer.pack(&slope, 48).unwrap().len() < 40, "rows of one slope are one difference");
    }

    #[test]
    fn bytes_of_another_size_or_kind_are_refused() {
        let (mut packer, mut unpacker) = (Packer::new().unwrap(), Unpacker::new().unwrap());
        let packed = packer.pack(&[5; 48], 12).unwrap();
        for size in [0, 12, 47, 49] {
            assert!(unpacker.unpack(packed, 12, &mut vec![0; size]).is_err(), "{size}");
        }
        assert!(unpacker.unpack(&packed[..packed.len() - 1], 12, &mut [0; 48]).is_err());
        assert!(unpacker.unpack(b"something else", 12, &mut [0; 48]).is_err());
    }
}
