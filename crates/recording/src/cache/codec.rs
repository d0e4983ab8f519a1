//! The compression of a picture: its difference to an earlier one, or each row as its difference to the row above, then
//! zstd. Lossless.
//!
//! The measurements behind the choice are in docs/decisions/0036-frames-are-cached-compressed.md and
//! 0059-cameras-that-stand-still-are-cached-as-differences.md. Independent of files.

use std::io;

use zstd::bulk::{Compressor, Decompressor};

use super::layout::Place;

/// The fastest level: higher ones gain less than 1 % on pictures.
const LEVEL: i32 = 1;
/// The first byte of a packed picture: alone, or as a difference, which the place of its key follows.
const ALONE: u8 = 0;
const DIFFERENCE: u8 = 1;

/// The most bytes that a picture of `bytes` takes when it is packed.
pub(super) fn packed_bound(bytes: usize) -> usize {
    1 + Place::BYTES + zstd::zstd_safe::compress_bound(bytes)
}

/// The last picture of a stream that was packed alone. Later ones are packed as their difference to it.
pub(super) struct Key {
    place: Place,
    pixels: Vec<u8>,
    /// The smallest difference so far, packed bytes, and the sum of what each exceeded the smallest one before it by.
    least: usize,
    excess: usize,
}

impl Key {
    /// A key of which nothing is known but its pixels and its place in the file.
    pub(super) fn new(place: Place, pixels: &[u8]) -> Self {
        Self { place, pixels: pixels.to_vec(), least: usize::MAX, excess: 0 }
    }

    /// Whether a picture is better packed as a difference of this many bytes than as a new key of `alone` bytes. A scene
    /// moves away from its key, so a new one begins where the differences have grown by as much as a key takes.
    fn serves(&mut self, difference: usize, alone: usize) -> bool {
        let least = self.least.min(difference);
        let excess = self.excess + (difference - least);
        let serves = difference < alone && excess <= self.place.length as usize;
        if serves {
            (self.least, self.excess) = (least, excess);
        }
        serves
    }
}

/// Compresses pictures one after the other; its memory is reused.
pub(super) struct Packer {
    compressor: Compressor<'static>,
    plain: Vec<u8>,
    alone: Vec<u8>,
    difference: Vec<u8>,
}

/// A packed picture.
pub(super) struct Packed<'a> {
    pub(super) bytes: &'a [u8],
    /// Whether it is packed alone, so that later ones can have it as their key.
    pub(super) is_key: bool,
}

impl Packer {
    pub(super) fn new() -> io::Result<Self> {
        let compressor = Compressor::new(LEVEL)?;
        Ok(Self { compressor, plain: Vec::new(), alone: Vec::new(), difference: Vec::new() })
    }

    /// A picture with rows of `row_bytes`, valid until the next call; `key` has its size.
    pub(super) fn pack(&mut self, pixels: &[u8], row_bytes: usize, key: Option<&mut Key>) -> io::Result<Packed<'_>> {
        self.plain.clear();
        self.plain.extend_from_slice(pixels.get(..row_bytes).unwrap_or(pixels));
        let below = pixels.iter().skip(row_bytes).zip(pixels);
        self.plain.extend(below.map(|(value, above)| value.wrapping_sub(*above)));
        self.alone.clear();
        self.alone.push(ALONE);
        append(&mut self.compressor, &self.plain, &mut self.alone)?;
        let Some(key) = key else { return Ok(Packed { bytes: &self.alone, is_key: true }) };
        self.plain.clear();
        self.plain.extend(pixels.iter().zip(&key.pixels).map(|(value, before)| value.wrapping_sub(*before)));
        self.difference.clear();
        self.difference.push(DIFFERENCE);
        key.place.write(&mut self.difference);
        append(&mut self.compressor, &self.plain, &mut self.difference)?;
        let is_key = !key.serves(self.difference.len(), self.alone.len());
        Ok(Packed { bytes: if is_key { &self.alone } else { &self.difference }, is_key })
    }
}

fn append(compressor: &mut Compressor<'_>, plain: &[u8], packed: &mut Vec<u8>) -> io::Result<()> {
    let begin = packed.len();
    packed.resize(begin + zstd::zstd_safe::compress_bound(plain.len()), 0);
    let length = compressor.compress_to_buffer(plain, &mut packed[begin..])?;
    packed.truncate(begin + length);
    Ok(())
}

/// Decompresses pictures one after the other; its memory is reused.
pub(super) struct Unpacker(Decompressor<'static>);

impl Unpacker {
    pub(super) fn new() -> io::Result<Self> {
        Ok(Self(Decompressor::new()?))
    }

    /// The place of the picture's key and the rest of the packed bytes; no key if it is packed alone.
    ///
    /// # Errors
    /// The reason why `packed` is no picture.
    pub(super) fn key(packed: &[u8]) -> Result<(Option<Place>, &[u8]), String> {
        match packed.split_first() {
            Some((&ALONE, rest)) => Ok((None, rest)),
            Some((&DIFFERENCE, rest)) => {
                let (place, rest) = Place::parse(rest).ok_or("a picture ends before the place of its key")?;
                Ok((Some(place), rest))
            }
            Some((kind, _)) => Err(format!("a picture is of kind {kind}")),
            None => Err("a picture has no bytes".to_owned()),
        }
    }

    /// Fills `pixels`, a picture with rows of `row_bytes`, from what follows its kind.
    ///
    /// # Errors
    /// The reason why `packed` is no picture of this size.
    pub(super) fn alone(&mut self, packed: &[u8], row_bytes: usize, pixels: &mut [u8]) -> Result<(), String> {
        self.fill(packed, pixels)?;
        let mut rows = pixels.chunks_exact_mut(row_bytes.max(1));
        let Some(mut above) = rows.next() else { return Ok(()) };
        for row in rows {
            add(row, above);
            above = row;
        }
        Ok(())
    }

    /// Fills `pixels` from what follows the place of its key, whose pixels are given.
    ///
    /// # Errors
    /// The reason why `packed` is no picture of this size.
    pub(super) fn difference(&mut self, packed: &[u8], key: &[u8], pixels: &mut [u8]) -> Result<(), String> {
        self.fill(packed, pixels)?;
        add(pixels, key);
        Ok(())
    }

    fn fill(&mut self, packed: &[u8], pixels: &mut [u8]) -> Result<(), String> {
        match self.0.decompress_to_buffer(packed, pixels) {
            Ok(found) if found == pixels.len() => Ok(()),
            Ok(found) => Err(format!("a picture unpacks to {found} bytes instead of {}", pixels.len())),
            Err(error) => Err(format!("a picture cannot be unpacked ({error})")),
        }
    }
}

fn add(values: &mut [u8], others: &[u8]) {
    values.iter_mut().zip(others).for_each(|(value, other)| *value = value.wrapping_add(*other));
}

#[cfg(test)]
mod tests {

    use super::*;

    fn noise(seed: u32, bytes: usize) -> Vec<u8> {
        let mut state = seed;
        let mut next = |_| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            state.to_be_bytes()[0]
        };
        (0..bytes).map(&mut next).collect()
    }

    fn unpacked(packed: &[u8], row_bytes: usize, key: &[u8], size: usize) -> Result<Vec<u8>, String> {
        let (mut unpacker, mut pixels) = (Unpacker::new().unwrap(), vec![1; size]);
        match Unpacker::key(packed)? {
            (None, rest) => unpacker.alone(rest, row_bytes, &mut pixels)?,
            (Some(_), rest) => unpacker.difference(rest, key, &mut pixels)?,
        }
        Ok(pixels)
    }

    #[test]
    fn every_picture_comes_back_bit_for_bit() {
        let noise = noise(1, 16 * 16 * 3);
        let slope: Vec<u8> = (0..16 * 48).map(|at| u8::try_from(at / 48 * 9 % 256).unwrap()).collect();
        let mut packer = Packer::new().unwrap();
        for (pixels, row_bytes) in [(&noise, 48), (&slope, 48), (&vec![255; 32], 32), (&vec![7, 9], 2)] {
            let packed = packer.pack(pixels, row_bytes, None).unwrap();
            assert!(packed.is_key && packed.bytes.len() < pixels.len() + 32);
            assert_eq!(unpacked(packed.bytes, row_bytes, &[], pixels.len()).unwrap(), *pixels);
        }
        let packed = packer.pack(&slope, 48, None).unwrap();
        assert!(packed.bytes.len() < 40, "rows of one slope are one difference");
    }

    #[test]
    fn a_picture_like_its_key_is_a_small_difference_and_another_is_a_key() {
        let (scene, other) = (noise(1, 32 * 96), noise(2, 32 * 96));
        let place = Place { offset: 70, length: 3000, crc: 5 };
        let mut key = Key::new(place, &scene);
        let mut moved = scene.clone();
        moved[500..520].copy_from_slice(&other[..20]);
        let mut packer = Packer::new().unwrap();
        let packed = packer.pack(&moved, 96, Some(&mut key)).unwrap();
        assert!(!packed.is_key && packed.bytes.len() < 100, "{}", packed.bytes.len());
        assert_eq!(Unpacker::key(packed.bytes).unwrap().0, Some(place));
        assert_eq!(unpacked(packed.bytes, 96, &scene, scene.len()).unwrap(), moved);
        let packed = packer.pack(&other, 96, Some(&mut key)).unwrap();
        assert!(packed.is_key);
        assert_eq!(unpacked(packed.bytes, 96, &[], other.len()).unwrap(), other);
    }

    #[test]
    fn a_new_key_begins_where_differences_have_grown_by_a_key() {
        let mut key = Key::new(Place { offset: 0, length: 1000, crc: 0 }, &[]);
        let served = [300, 200, 600, 700, 900, 200].map(|difference| key.serves(difference, 1000));
        assert_eq!(served, [true, true, true, true, false, true], "least 200; 400, 900, then 1600 more");
        assert!(!key.serves(300, 300), "equal sizes are packed alone");
    }

    #[test]
    fn bytes_of_another_size_or_kind_are_refused() {
        let mut packer = Packer::new().unwrap();
        let packed = packer.pack(&[5; 48], 12, None).unwrap().bytes;
        for size in [0, 12, 47, 49] {
            assert!(unpacked(packed, 12, &[], size).is_err(), "{size}");
        }
        assert!(unpacked(&packed[..packed.len() - 1], 12, &[], 48).is_err());
        assert!(unpacked(b"something else", 12, &[], 48).unwrap_err().contains("kind 115"));
        assert!(unpacked(b"", 12, &[], 48).is_err());
        assert!(unpacked(&[DIFFERENCE, 1, 2], 12, &[0; 48], 48).unwrap_err().contains("place of its key"));
    }
}
