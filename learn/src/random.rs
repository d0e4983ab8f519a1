//! Random numbers that depend on nothing but (seed, purpose, counter).
//!
//! A generator is made anew for every step, so a resumed run draws exactly what a straight run
//! draws, without saving any generator's state. Knows nothing of what the numbers are for.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// What the numbers are for; each purpose is a stream of its own.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Purpose {
    /// First weights; the counter is the parameter's place in name order.
    Weights = 1,
    /// Which elements are masked; the counter is the step.
    Mask = 2,
    /// Which segments make a pretraining or expert batch; the counter is the step.
    Batch = 3,
    /// Which segments make a kept batch; the counter is the step.
    KeptBatch = 4,
}

/// The generator of `purpose` at `counter`.
pub(crate) fn generator(seed: u64, purpose: Purpose, counter: u64) -> ChaCha8Rng {
    let mut key = [0u8; 32];
    key[..8].copy_from_slice(&seed.to_le_bytes());
    key[8..16].copy_from_slice(&(purpose as u64).to_le_bytes());
    key[16..24].copy_from_slice(&counter.to_le_bytes());
    ChaCha8Rng::from_seed(key)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use rand::Rng;

    use super::*;

    #[test]
    fn the_same_key_repeats_and_every_part_of_it_counts() {
        let first = |seed, purpose, counter| generator(seed, purpose, counter).next_u64();
        let base = first(1, Purpose::Mask, 5);
        assert_eq!(base, first(1, Purpose::Mask, 5));
        assert_ne!(base, first(2, Purpose::Mask, 5));
        assert_ne!(base, first(1, Purpose::Batch, 5));
        assert_ne!(base, first(1, Purpose::Mask, 6));
    }
}
