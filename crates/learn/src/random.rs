//! Random numbers that depend only on (seed, purpose, counter).
//!
//! A generator is made for every batch, so a resumed run draws exactly what a straight run
//! draws, without saving any generator's state. Independent of the purpose of the numbers.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// The use of the numbers; each purpose has a separate stream.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Purpose {
    /// Initial weights; the counter is the parameter's place in name order.
    Weights = 1,
    /// The masked elements; the counter is the batch.
    Mask = 2,
    /// The segments of a pretraining or expert batch; the counter is the batch.
    Batch = 3,
    /// The segments of a kept batch; the counter is the batch.
    KeptBatch = 4,
    /// The changes of a pretraining or expert batch's images; the counter is the batch.
    Augmentation = 5,
    /// The changes of a kept batch's images; the counter is the batch.
    KeptAugmentation = 6,
    /// The other random parts of an expert batch: styles, hidden pasts; the counter is the batch.
    Style = 7,
    /// The other random parts of a kept batch; the counter is the batch.
    KeptStyle = 8,
    /// The episodes on which the scale of features is measured; the counter is 0.
    FeatureScale = 9,
    /// The pairs of segments by which a policy's inputs are compared; the counter is 0.
    Shares = 10,
    /// The episodes that are held out, and the random parts of their losses; the counter is 0 and 1.
    Validation = 11,
    /// The actions that a policy draws; the counter is the number of observations that its passes have read.
    Action = 12,
    /// The corruption of an expert's actions; the counter is the expert's number.
    Corruption = 13,
    /// The scores of the control; the counter is made of the episode's id.
    RandomScore = 14,
    /// The hidden values that are dropped in the pass over an expert batch; the counter is made of the batch and the layer.
    Dropout = 15,
    /// Those of a kept batch.
    KeptDropout = 16,
}

/// The generator of `purpose` at `counter`.
pub(crate) fn generator(seed: u64, purpose: Purpose, counter: u64) -> ChaCha8Rng {
    let mut key = [0u8; 32];
    key[..8].copy_from_slice(&seed.to_le_bytes());
    key[8..16].copy_from_slice(&(purpose as u64).to_le_bytes());
    key[16..24].copy_from_slice(&counter.to_le_bytes());
    ChaCha8Rng::from_seed(key)
}

/// `count` numbers from N(0, 1), by the Box-Muller transform.
pub(crate) fn normal(rng: &mut ChaCha8Rng, count: usize) -> Vec<f32> {
    let pair = || {
        // In (0, 1], so that the logarithm is finite.
        let radius = (-2.0 * (1.0 - rng.random::<f64>()).ln()).sqrt();
        let (sine, cosine) = (std::f64::consts::TAU * rng.random::<f64>()).sin_cos();
        #[expect(clippy::cast_possible_truncation, reason = "noise needs no more digits than f32 has")]
        [radius * cosine, radius * sine].map(|value| value as f32)
    };
    std::iter::repeat_with(pair).flatten().take(count).collect()
}

#[cfg(test)]
mod tests {
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

    #[test]
    fn normal_numbers_have_the_moments_of_the_normal() {
        let numbers = normal(&mut generator(5, Purpose::Style, 0), 40_001);
        assert_eq!(numbers.len(), 40_001);
        let moment = |power: i32| numbers.iter().map(|x| f64::from(*x).powi(power)).sum::<f64>() / 40_001.0;
        // Standard errors: 0.005, 0.007, 0.02, 0.05.
        assert!(moment(1).abs() < 0.02 && (moment(2) - 1.0).abs() < 0.03);
        assert!(moment(3).abs() < 0.08 && (moment(4) - 3.0).abs() < 0.2);
    }
}
