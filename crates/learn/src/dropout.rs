//! Dropout in a training's passes: hidden values that are zero at random. Independent of models and of the loop.
//!
//! The tensor library's own dropout draws from one generator for all threads, whose state a resumed run would need.

use std::cell::RefCell;
use std::ops::Range;

use rand::Rng;
use tch::Tensor;

use crate::device::send;
use crate::random::{Purpose, generator};

/// Passes of one batch have at most this many layers that drop values.
const LAYERS: u64 = 1 << 16;
/// Values are drawn as numbers of 16 bits, so a chance is rounded up to a multiple of one of these parts.
const PARTS: f64 = 65_536.0;

/// What is dropped in the pass over one batch.
#[derive(Debug, Clone)]
pub(crate) struct Dropout {
    /// Chance of each value to be zero, below 1.
    pub(crate) chance: f64,
    /// Seed, purpose and number of the batch, by which the values are drawn.
    pub(crate) key: (u64, Purpose, u64),
    /// The windows of the pass among those of the whole batch: each has the values that it has in a pass over all.
    pub(crate) windows: Range<usize>,
}

/// A pass with dropout, and the layers that have dropped values in it.
struct Pass {
    dropout: Dropout,
    layers: u64,
}

thread_local! {
    static PASS: RefCell<Option<Pass>> = const { RefCell::new(None) };
}

/// Ends dropout on the thread, also after a panic.
struct End;

impl Drop for End {
    fn drop(&mut self) {
        PASS.set(None);
    }
}

/// Runs `pass`, of one batch, on this thread with `dropout` in its layers. Gradients follow the pass they are of.
pub(crate) fn with<T>(dropout: Dropout, pass: impl FnOnce() -> T) -> T {
    let _end = End;
    PASS.set((dropout.chance > 0.0).then_some(Pass { dropout, layers: 0 }));
    pass()
}

/// Hidden values `[W, …]` or `[W n, …]`, n rows for each window one after the other; in a pass with dropout some of them
/// zero and the others larger, so that the mean of each stays as it is.
pub(crate) fn dropped(values: Tensor) -> Tensor {
    PASS.with_borrow_mut(|pass| match pass {
        None => values,
        Some(pass) => {
            pass.layers += 1;
            &values * pass.factors(&values)
        }
    })
}

impl Pass {
    /// The factors of the values of the present layer.
    fn factors(&self, values: &Tensor) -> Tensor {
        let Dropout { chance, key: (seed, purpose, batch), windows } = &self.dropout;
        let count = values.numel();
        let mut rng = generator(*seed, *purpose, batch * LAYERS + self.layers);
        // Two values of each number of four bytes.
        let before = count / windows.len().max(1) * windows.start;
        rng.set_word_pos((before / 2) as u128);
        let mut bytes = vec![0u8; 2 * (count + before % 2)];
        rng.fill_bytes(&mut bytes);
        let drawn = bytes.chunks_exact(2).skip(before % 2).map(|pair| u16::from_le_bytes([pair[0], pair[1]]));
        let kept: Vec<bool> = drawn.map(|drawn| f64::from(drawn) >= chance * PARTS).collect();
        let kept = send(&Tensor::from_slice(&kept), values.device()).view_as(values);
        kept.to_kind(values.kind()) * (1.0 / (1.0 - chance))
    }
}

#[cfg(test)]
mod tests {
    use tch::{Device, Kind};

    use super::*;
    use crate::batch::{int, values};
    use crate::error::guard;

    fn ones(windows: Range<usize>, width: usize) -> Tensor {
        Tensor::ones([int(windows.len()), int(width)], (Kind::Float, Device::Cpu))
    }

    /// What two layers of `width` values let pass.
    fn layers(chance: f64, batch: u64, windows: Range<usize>, width: usize) -> [Vec<f32>; 2] {
        let ones = || ones(windows.clone(), width);
        let dropout = Dropout { chance, key: (1, Purpose::Dropout, batch), windows: windows.clone() };
        with(dropout, || [(); 2].map(|()| values(&dropped(ones()).view(-1))))
    }

    #[test]
    fn a_share_of_values_is_zero_and_the_mean_stays() {
        for chance in [0.1, 0.5] {
            for found in layers(chance, 0, 0..200, 100) {
                let zero = found.iter().filter(|value| **value == 0.0).count() as f64 / 20_000.0;
                // Five standard errors.
                assert!((zero - chance).abs() < 5.0 * (chance * (1.0 - chance) / 20_000.0).sqrt(), "{chance}: {zero}");
                let kept = 1.0 / (1.0 - chance);
                assert!(found.iter().all(|value| *value == 0.0 || (f64::from(*value) - kept).abs() < 1e-6));
            }
        }
    }

    #[test]
    fn layers_batches_and_seeds_differ_and_the_same_ones_repeat() {
        let [first, second] = layers(0.5, 0, 0..8, 16);
        assert_ne!(first, second);
        assert_eq!([first.clone(), second], layers(0.5, 0, 0..8, 16));
        assert_ne!(first, layers(0.5, 1, 0..8, 16)[0]);
    }

    #[test]
    fn parts_of_a_batch_drop_what_the_whole_does() {
        for width in [5, 8] {
            let whole = layers(0.3, 4, 0..7, width);
            let (first, rest) = (layers(0.3, 4, 0..3, width), layers(0.3, 4, 3..7, width));
            for layer in 0..2 {
                assert_eq!(whole[layer], [first[layer].clone(), rest[layer].clone()].concat(), "{width}");
            }
        }
    }

    #[test]
    fn nothing_drops_outside_the_pass_or_at_a_chance_of_zero() {
        let all = vec![1.0f32; 12];
        assert_eq!(layers(0.0, 0, 0..3, 4), [all.clone(), all.clone()]);
        let _ = layers(0.9, 0, 0..3, 4);
        assert_eq!(values(&dropped(ones(0..3, 4)).view(-1)), all);
        let dropout = Dropout { chance: 0.9, key: (1, Purpose::Dropout, 0), windows: 0..3 };
        assert!(guard(|| with(dropout, || -> Result<(), _> { panic!("within the pass") })).is_err());
        assert_eq!(values(&dropped(ones(0..3, 4)).view(-1)), all);
    }
}
