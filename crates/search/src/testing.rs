//! Random numbers for this crate's tests.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::points::{PARTS, PointShape, Points};

/// The generator of this seed and stream.
pub(crate) fn generator(seed: u64, stream: u64) -> ChaCha8Rng {
    let mut key = [0u8; 32];
    key[..8].copy_from_slice(&seed.to_le_bytes());
    key[8..16].copy_from_slice(&2u64.to_le_bytes());
    key[16..24].copy_from_slice(&stream.to_le_bytes());
    ChaCha8Rng::from_seed(key)
}

/// Groups of windows of `length` rows, each group with its number of rows, and the same points with rows of their own.
pub(crate) fn windows(rows: &[usize], widths: [usize; PARTS], length: usize) -> (Vec<Points>, Vec<Points>) {
    let group = |(number, rows): (usize, &usize)| {
        let mut rng = generator(number as u64, 14);
        let values = widths.map(|width| (0..rows * width).map(|_| 1.0 + rng.random_range(-0.5f32..0.5)).collect());
        let windows = Points::new(values, PointShape { widths, length }).unwrap();
        let of = |part: usize| (0..windows.count()).flat_map(|at| windows.row(part, at)).copied().collect();
        let plain = Points::new([of(0), of(1), of(2)], windows.widths()).unwrap();
        (windows, plain)
    };
    rows.iter().enumerate().map(group).unzip()
}
