//! M(τ): the choice of a segment's masked elements.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// The ratios from which a sample draws its own.
pub(crate) const RATIOS: [f64; 4] = [0.4, 0.3, 0.2, 0.1];
const MODALITIES: usize = 3;

/// Draws the indicator I(e_t) of `[W, L, 3]` elements, row-major, where `valid` `[W, L]` marks the places inside the
/// episode.
///
/// Each sample draws its ratio, each valid element is masked with that probability on its own.
/// Padding is never masked; at least one element is, and at least one is not.
pub(crate) fn draw(rng: &mut ChaCha8Rng, valid: &[bool], length: usize) -> Vec<bool> {
    let mut masked = vec![false; valid.len() * MODALITIES];
    let samples = valid.chunks(length).zip(masked.chunks_mut(length * MODALITIES));
    for (valid, masked) in samples {
        let ratio = RATIOS[rng.random_range(0..RATIOS.len())];
        let elements: Vec<usize> = (0..masked.len()).filter(|element| valid[element / MODALITIES]).collect();
        for element in &elements {
            masked[*element] = rng.random_bool(ratio);
        }
        let chosen = elements[rng.random_range(0..elements.len())];
        let count = elements.iter().filter(|element| masked[**element]).count();
        if count == 0 || count == elements.len() {
            masked[chosen] = count == 0;
        }
    }
    masked
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Purpose, generator};

    #[test]
    fn padding_is_never_masked_and_every_sample_has_both_kinds() {
        let valid: Vec<bool> = [[false, false, true], [false, true, true]].concat();
        for step in 0..2_000 {
            let masked = draw(&mut generator(1, Purpose::Mask, step), &valid, 3);
            assert_eq!(masked.len(), 18);
            assert!(masked[..6].iter().all(|m| !m) && masked[9..12].iter().all(|m| !m));
            for elements in [&masked[6..9], &masked[12..]] {
                assert!(elements.iter().any(|m| *m) && elements.iter().any(|m| !*m));
            }
        }
    }

    #[test]
    fn ratios_are_those_of_the_paper() {
        // 21 elements: the share masked per sample clusters at the four ratios; its mean is 0.25.
        let valid = vec![true; 7 * 20_000];
        let masked = draw(&mut generator(2, Purpose::Mask, 0), &valid, 7);
        let counts: Vec<usize> = masked.chunks(21).map(|sample| sample.iter().filter(|m| **m).count()).collect();
        #[expect(clippy::cast_precision_loss, reason = "a count of elements")]
        let share = |n: usize, of: usize| n as f64 / of as f64;
        let mean = share(counts.iter().sum(), masked.len());
        assert!((mean - 0.25).abs() < 0.01, "{mean}");
        // P(12 or more of 21) = mean over the ratios of the binomial tail: 0.0874/4 at 0.4, 0.0087/4 at 0.3, 0 for the
        // others; one fixed ratio of 0.25 would give 0.0021.
        let tail = share(counts.iter().filter(|n| **n >= 12).count(), counts.len());
        assert!((0.018..0.03).contains(&tail), "{tail}");
    }
}
