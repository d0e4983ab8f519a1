//! Statistics of evaluations: AUROC of scores, precision and recall, intervals of success rates, agreement of rankings.
//!
//! Plain functions over numbers, which depend on neither the simulator nor tensors.

mod levels;
mod rank;
mod strata;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

pub use levels::{Attempts, difference_over_levels, rate_over_levels};
pub use rank::{jaccard, mid_ranks, spearman};
pub use strata::{Stratified, auroc_within, quantile_bins};

/// The number of resamples of a bootstrap interval.
const RESAMPLES: usize = 2_000;

/// Area under the ROC curve: the probability that a random positive scores higher than a random negative, ties counted as
/// half. `None` if one of the two classes is empty or a score is NaN.
#[must_use]
pub fn auroc(scored: &[(f64, bool)]) -> Option<f64> {
    area(&ranked(std::iter::once(scored))?, &[1.0])
}

/// The 95 % bootstrap interval of the AUROC over episodes: `(low, high)`.
///
/// Steps of one episode are correlated, so whole episodes are drawn with replacement, 2,000 times. The interval is from the
/// 2.5 % to the 97.5 % quantile of the results; a draw without one of the classes is omitted. The same episodes and seed
/// give the same interval. `None` if [`auroc`] of all steps is.
#[must_use]
pub fn auroc_interval(episodes: &[Vec<(f64, bool)>], seed: u64) -> Option<(f64, f64)> {
    let ranked = ranked(episodes.iter().map(Vec::as_slice))?;
    area(&ranked, &vec![1.0; episodes.len()])?;
    bootstrap(episodes.len(), seed, |times| area(&ranked, times))
}

/// The AUROC of scores less that of others, with its 95 % bootstrap interval over episodes: `(difference, low, high)`.
///
/// `a` and `b` have the same episodes in the same order, scored twice. Each draw as in [`auroc_interval`] is the same for
/// both, so that the interval is narrower than those of its parts where the scores agree on which episodes are hard.
/// `None` if either [`auroc`] is, or the numbers of episodes differ.
#[must_use]
pub fn auroc_difference(a: &[Vec<(f64, bool)>], b: &[Vec<(f64, bool)>], seed: u64) -> Option<(f64, f64, f64)> {
    if a.len() != b.len() {
        return None;
    }
    let a_ranked = ranked(a.iter().map(Vec::as_slice))?;
    let b_ranked = ranked(b.iter().map(Vec::as_slice))?;
    let difference = |times: &[f64]| Some(area(&a_ranked, times)? - area(&b_ranked, times)?);
    let whole = difference(&vec![1.0; a.len()])?;
    let (low, high) = bootstrap(a.len(), seed, difference)?;
    Some((whole, low, high))
}

/// The 2.5 % and the 97.5 % quantile of a statistic over resamples of episodes, each a multiplicity for every episode.
fn bootstrap(episodes: usize, seed: u64, statistic: impl Fn(&[f64]) -> Option<f64>) -> Option<(f64, f64)> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let draw = |_| {
        let mut times = vec![0.0; episodes];
        for _ in 0..episodes {
            times[random.random_range(0..episodes)] += 1.0;
        }
        statistic(&times)
    };
    central((0..RESAMPLES).filter_map(draw).collect())
}

/// The 2.5 % and the 97.5 % quantile of resampled values; `None` without any.
fn central(mut values: Vec<f64>) -> Option<(f64, f64)> {
    values.sort_by(f64::total_cmp);
    // The ranks with one in forty outside at either end.
    let outside = values.len() / 40;
    Some((*values.get(outside)?, *values.get(values.len() - 1 - outside)?))
}

/// A scored step of an episode.
struct Step {
    score: f64,
    positive: bool,
    episode: usize,
}

/// All steps in the order of their scores; `None` if a score is NaN.
fn ranked<'a>(episodes: impl Iterator<Item = &'a [(f64, bool)]>) -> Option<Vec<Step>> {
    let steps = episodes
        .enumerate()
        .flat_map(|(episode, scored)| scored.iter().map(move |&(score, positive)| Step { score, positive, episode }));
    let mut steps: Vec<Step> = steps.collect();
    steps.sort_by(|a, b| a.score.total_cmp(&b.score));
    steps.iter().all(|step| !step.score.is_nan()).then_some(steps)
}

/// The area under the ROC curve with a multiplicity for each episode.
fn area(ranked: &[Step], times: &[f64]) -> Option<f64> {
    let (won, all) = pairs(ranked, times);
    (all > 0.0).then(|| won / all)
}

/// The pairs of a positive and a negative that the positive wins, ties counted as half, and all pairs, with a multiplicity
/// for each episode.
fn pairs(ranked: &[Step], times: &[f64]) -> (f64, f64) {
    let (mut pairs_won, mut negatives, mut positives) = (0.0_f64, 0.0_f64, 0.0_f64);
    for tied in ranked.chunk_by(|a, b| a.score == b.score) {
        let (mut tied_positives, mut tied_negatives) = (0.0, 0.0);
        for step in tied {
            *(if step.positive { &mut tied_positives } else { &mut tied_negatives }) += times[step.episode];
        }
        pairs_won += tied_positives * (negatives + tied_negatives / 2.0);
        negatives += tied_negatives;
        positives += tied_positives;
    }
    (pairs_won, negatives * positives)
}

/// Precision and recall of the kept items with respect to the good ones; `None` without kept or without good items. Items
/// beyond the shorter list are ignored.
#[must_use]
pub fn precision_recall(kept: &[bool], good: &[bool]) -> (Option<f64>, Option<f64>) {
    let (mut both, mut kept_count, mut good_count) = (0_u32, 0_u32, 0_u32);
    for (&is_kept, &is_good) in kept.iter().zip(good) {
        both += u32::from(is_kept && is_good);
        kept_count += u32::from(is_kept);
        good_count += u32::from(is_good);
    }
    let share = |of: u32| (of > 0).then(|| f64::from(both) / f64::from(of));
    (share(kept_count), share(good_count))
}

/// The 95 % Wilson score interval of a success rate; `(0, 1)` without attempts.
#[must_use]
pub fn wilson(successes: u32, total: u32) -> (f64, f64) {
    if total == 0 {
        return (0.0, 1.0);
    }
    // The 97.5 % quantile of the standard normal distribution.
    let z = 1.959_963_984_540_054_f64;
    let n = f64::from(total);
    let p = f64::from(successes) / n;
    let centre = p + z * z / (2.0 * n);
    let spread = z * (p * (1.0 - p) / n + z * z / (4.0 * n * n)).sqrt();
    let scale = 1.0 + z * z / n;
    (((centre - spread) / scale).max(0.0), ((centre + spread) / scale).min(1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn auroc_counts_ordered_pairs() {
        assert_eq!(auroc(&[(0.9, true), (0.1, false)]), Some(1.0));
        assert_eq!(auroc(&[(0.1, true), (0.9, false)]), Some(0.0));
        // Pairs: (0.5, 0.4) won, (0.5, 0.5) tied, (0.2, both) lost.
        assert_eq!(auroc(&[(0.5, true), (0.2, true), (0.4, false), (0.5, false)]), Some(1.5 / 4.0));
        assert_eq!(auroc(&[(0.5, true)]), None);
        assert_eq!(auroc(&[(f64::NAN, true), (0.1, false)]), None);
    }

    /// Episodes of 10 steps whose positives score higher by a fixed amount, under noise that all steps of an episode
    /// share.
    fn episodes(count: usize, seed: u64) -> Vec<Vec<(f64, bool)>> {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut episode = |_| {
            let (shared, level) = (random.random_range(0.0..1.0), random.random_range(0.0..1.0) < 0.5);
            (0..10).map(|step| (shared + f64::from(step) * 1e-6 + if level { 0.3 } else { 0.0 }, level)).collect()
        };
        (0..count).map(&mut episode).collect()
    }

    #[test]
    fn interval_contains_the_true_area_at_its_level() {
        // Both uniform on a unit interval, 0.3 apart: 1 − 0.7² / 2.
        let truth = 0.755;
        let held = (0..60).filter(|&seed| {
            let (low, high) = auroc_interval(&episodes(60, seed), seed).unwrap();
            low <= truth && truth <= high
        });
        let held = held.count();
        assert!((51..=60).contains(&held), "{held} of 60");
    }

    #[test]
    fn interval_is_reproducible_and_narrows_with_more_episodes() {
        let width = |count| {
            let (low, high) = auroc_interval(&episodes(count, 1), 5).unwrap();
            let area = auroc(&episodes(count, 1).concat()).unwrap();
            assert!(low < area && area < high, "{low} {area} {high}");
            high - low
        };
        assert_eq!(width(40), width(40));
        assert!(width(400) < 0.5 * width(40), "{} {}", width(400), width(40));
    }

    #[test]
    fn repeated_steps_of_an_episode_do_not_narrow_the_interval() {
        let few = episodes(30, 2);
        let many: Vec<_> = few.iter().map(|episode| episode.repeat(20)).collect();
        assert_eq!(auroc_interval(&few, 3), auroc_interval(&many, 3));
    }

    #[test]
    fn a_paired_difference_is_narrower_than_its_parts() {
        let hard = episodes(60, 4);
        let noise = episodes(60, 9);
        // The same scores, and the same with a little of something else.
        let other: Vec<Vec<(f64, bool)>> = hard
            .iter()
            .zip(&noise)
            .map(|(of, with)| of.iter().zip(with).map(|(step, extra)| (step.0 + 0.1 * extra.0, step.1)).collect())
            .collect();
        assert_eq!(auroc_difference(&hard, &hard, 1), Some((0.0, 0.0, 0.0)));
        let (difference, low, high) = auroc_difference(&hard, &other, 1).unwrap();
        let parts = auroc(&hard.concat()).unwrap() - auroc(&other.concat()).unwrap();
        assert!((difference - parts).abs() < 1e-12 && low <= difference && difference <= high);
        let (alone_low, alone_high) = auroc_interval(&hard, 1).unwrap();
        assert!(high - low < 0.5 * (alone_high - alone_low), "{low} {high} {alone_low} {alone_high}");
        let (turned, turned_low, turned_high) = auroc_difference(&other, &hard, 1).unwrap();
        assert!(
            (turned + difference).abs() < 1e-12 && (turned_low + high).abs() < 1e-3 && (turned_high + low).abs() < 1e-3
        );
        assert_eq!(auroc_difference(&hard, &other[1..], 1), None);
        assert_eq!(auroc_difference(&hard, &vec![vec![(f64::NAN, true)]; 60], 1), None);
    }

    #[test]
    fn one_class_has_no_interval() {
        assert_eq!(auroc_interval(&[], 0), None);
        assert_eq!(auroc_interval(&[vec![(0.5, true)], vec![]], 0), None);
        assert_eq!(auroc_interval(&[vec![(f64::NAN, true), (0.5, false)]], 0), None);
        let perfect = vec![vec![(0.9, true), (0.1, false)]; 5];
        assert_eq!(auroc_interval(&perfect, 0), Some((1.0, 1.0)));
    }

    #[test]
    fn precision_and_recall_share_the_hits() {
        let (precision, recall) = precision_recall(&[true, true, false, false], &[true, false, true, true]);
        assert_eq!((precision, recall), (Some(0.5), Some(1.0 / 3.0)));
        assert_eq!(precision_recall(&[false], &[false]), (None, None));
    }

    #[test]
    fn wilson_matches_the_published_example() {
        // 81 of 263: (0.2553, 0.3662), Newcombe 1998.
        let (low, high) = wilson(81, 263);
        assert!((low - 0.2553).abs() < 5e-5 && (high - 0.3662).abs() < 5e-5, "{low} {high}");
        assert_eq!(wilson(0, 0), (0.0, 1.0));
    }
}
