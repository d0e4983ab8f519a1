//! Intervals of success rates over two levels at once: the trainings (draws of experts, seeds) and the attempts of each.
//!
//! Wilson's interval takes the trainings as given, Student's takes each rate as exact; the hierarchical bootstrap resamples
//! both. Must not depend on what a training or an attempt is.

use rand::RngExt as _;
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Binomial, Distribution as _};

use super::{RESAMPLES, central};

/// The attempts of one training.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Attempts {
    /// Attempts that succeeded, at most `total`.
    pub successes: u32,
    /// All attempts.
    pub total: u32,
}

impl Attempts {
    fn rate(self) -> f64 {
        f64::from(self.successes) / f64::from(self.total.max(1))
    }

    /// The rate of as many attempts drawn with replacement.
    fn resampled(self, random: &mut ChaCha8Rng) -> f64 {
        let drawn = Binomial::new(u64::from(self.total), self.rate().min(1.0)).map_or(0, |law| law.sample(random));
        // As many as `total` at most.
        f64::from(u32::try_from(drawn).unwrap_or(self.total)) / f64::from(self.total.max(1))
    }
}

/// The 95 % interval of the mean success rate over trainings: `(low, high)`.
///
/// Each of 2,000 resamples draws as many trainings with replacement, then the attempts of each drawn one. The same trainings
/// and seed give the same interval. `None` unless there are two trainings, since one has no spread to draw from.
#[must_use]
pub fn rate_over_levels(trainings: &[Attempts], seed: u64) -> Option<(f64, f64)> {
    over_levels(trainings, seed, |attempts, random| attempts.resampled(random))
}

/// The 95 % interval of the mean difference of success, first less second of each pair, as in [`rate_over_levels`].
///
/// A pair is drawn as one, because both of its trainings share recordings and draw of experts. Attempts are drawn for each
/// side on its own, which never makes the interval too narrow.
#[must_use]
pub fn difference_over_levels(pairs: &[(Attempts, Attempts)], seed: u64) -> Option<(f64, f64)> {
    over_levels(pairs, seed, |(one, other), random| one.resampled(random) - other.resampled(random))
}

fn over_levels<T: Copy>(trainings: &[T], seed: u64, value: impl Fn(T, &mut ChaCha8Rng) -> f64) -> Option<(f64, f64)> {
    if trainings.len() < 2 {
        return None;
    }
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut mean = || {
        let mut sum = 0.0;
        for _ in trainings {
            let drawn = trainings[random.random_range(0..trainings.len())];
            sum += value(drawn, &mut random);
        }
        sum / trainings.len() as f64
    };
    central((0..RESAMPLES).map(|_| mean()).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(successes: &[u32], total: u32) -> Vec<Attempts> {
        successes.iter().map(|&successes| Attempts { successes, total }).collect()
    }

    fn half((low, high): (f64, f64)) -> f64 {
        (high - low) / 2.0
    }

    #[test]
    fn equal_trainings_leave_the_spread_of_their_attempts() {
        // 10 × 100 attempts at 0.5: deviation of the mean √(0.25 / 1000) = 0.0158.
        let interval = rate_over_levels(&of(&[50; 10], 100), 1).unwrap();
        assert!((half(interval) - 1.96 * 0.0158).abs() < 0.003, "{interval:?}");
        // Attempts that all succeed have no spread.
        assert_eq!(rate_over_levels(&of(&[100; 3], 100), 1), Some((1.0, 1.0)));
    }

    #[test]
    fn many_attempts_leave_the_spread_of_trainings() {
        // Rates 0.2 and 0.8, five each: deviation of the mean 0.3 / √10 = 0.0949.
        let rates = [[20_000; 5], [80_000; 5]].concat();
        let interval = rate_over_levels(&of(&rates, 100_000), 2).unwrap();
        assert!((half(interval) - 1.96 * 0.0949).abs() < 0.02, "{interval:?}");
    }

    #[test]
    fn both_levels_widen_the_interval() {
        let rates = [30, 40, 50, 60, 70, 30, 40, 50, 60, 70];
        let both = rate_over_levels(&of(&rates, 100), 3).unwrap();
        let exact: Vec<u32> = rates.iter().map(|rate| rate * 1_000).collect();
        let trainings = rate_over_levels(&of(&exact, 100_000), 3).unwrap();
        let attempts = rate_over_levels(&of(&[50; 10], 100), 3).unwrap();
        let expected = (half(trainings).powi(2) + half(attempts).powi(2)).sqrt();
        assert!(half(both) > half(trainings) && (half(both) / expected - 1.0).abs() < 0.1, "{both:?} {expected}");
    }

    #[test]
    fn a_pair_is_drawn_as_one() {
        let rates = [10_000, 50_000, 90_000, 30_000];
        let one = of(&rates.map(|rate| rate + 5_000), 100_000);
        let pairs: Vec<(Attempts, Attempts)> = one.iter().copied().zip(of(&rates, 100_000)).collect();
        let (low, high) = difference_over_levels(&pairs, 4).unwrap();
        assert!(0.045 < low && high < 0.055, "{low} {high}");
        let turned: Vec<(Attempts, Attempts)> = pairs.iter().map(|&(one, other)| (other, one)).collect();
        let (turned_low, turned_high) = difference_over_levels(&turned, 4).unwrap();
        assert!(-0.055 < turned_low && turned_high < -0.045);
    }

    #[test]
    fn one_training_has_no_interval_and_the_seed_repeats_one() {
        assert_eq!(rate_over_levels(&of(&[50], 100), 1), None);
        assert_eq!(difference_over_levels(&[], 1), None);
        let none = [Attempts { successes: 0, total: 0 }; 2];
        assert_eq!(rate_over_levels(&none, 1), Some((0.0, 0.0)));
        let trainings = of(&[20, 60, 70], 100);
        assert_eq!(rate_over_levels(&trainings, 7), rate_over_levels(&trainings, 7));
        assert_ne!(rate_over_levels(&trainings, 7), rate_over_levels(&trainings, 8));
    }
}
