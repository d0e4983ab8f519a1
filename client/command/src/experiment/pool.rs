//! A cell's seeds as one: counts added up, the rest averaged.

use gleaner_core::statistics::{Attempts, rate_over_levels};

use super::interval::{deviation, student};
use super::rate::{RESAMPLING_SEED, Rate};
use super::report::{Pooled, PooledAuroc, SeedReport};
use crate::quality::{Selected, Separation, mean};

/// A cell's seeds as one.
pub(crate) fn pool(seeds: &[SeedReport]) -> Pooled {
    let rates: Vec<Rate> = seeds.iter().filter_map(|seed| seed.success).collect();
    let shares: Vec<f64> = rates.iter().map(|rate| rate.rate).collect();
    let attempts: Vec<Attempts> = rates.iter().map(|rate| rate.attempts()).collect();
    let total = |of: fn(&Rate) -> u32| rates.iter().map(of).sum::<u32>();
    let selected: Vec<&Selected> = seeds.iter().filter_map(|seed| seed.selected.as_ref()).collect();
    let over = |of: fn(&Selected) -> Option<f64>| {
        mean(&selected.iter().filter_map(|selected| of(selected)).collect::<Vec<_>>())
    };
    #[expect(clippy::cast_precision_loss, reason = "counts of segments are far below 2^52")]
    let kept = |selected: &Selected| Some(selected.kept as f64);
    Pooled {
        success: (!rates.is_empty()).then(|| Rate::new(total(|rate| rate.successes), total(|rate| rate.episodes))),
        mean_of_seeds: mean(&shares),
        deviation_of_seeds: deviation(&shares),
        interval_of_seeds: student(&shares).map(|(low, high)| (low.max(0.0), high.min(1.0))),
        interval_of_levels: rate_over_levels(&attempts, RESAMPLING_SEED),
        kept: over(kept),
        precision: over(|selected| selected.precision),
        recall: over(|selected| selected.recall),
        auroc: pool_auroc(seeds.iter().map(|seed| &seed.separation[..])),
    }
}

/// Separations of the same groups under several seeds as one, in the order of the first.
pub(super) fn pool_auroc<'a>(seeds: impl Iterator<Item = &'a [Separation]> + Clone) -> Vec<PooledAuroc> {
    let mut cohorts: Vec<&str> = Vec::new();
    for row in seeds.clone().flatten() {
        if !cohorts.contains(&row.cohort.as_str()) {
            cohorts.push(&row.cohort);
        }
    }
    let of = |cohort: &str| {
        let rows: Vec<&Separation> = seeds.clone().flatten().filter(|row| row.cohort == cohort).collect();
        let values: Vec<f64> = rows.iter().filter_map(|row| row.auroc).collect();
        let bounds = rows.iter().filter_map(|row| row.interval);
        let widest = bounds.reduce(|(low, high), (lower, higher)| (low.min(lower), high.max(higher)));
        Some(PooledAuroc { cohort: cohort.to_owned(), mean: mean(&values)?, interval: widest })
    };
    cohorts.into_iter().filter_map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::experiment::report::tests::seed;
    use gleaner_core::statistics::wilson;

    #[test]
    fn seeds_are_pooled_and_their_spread_is_kept() {
        let pooled = pool(&[seed(0, Some(2), Some(30)), seed(1, Some(4), Some(32))]);
        let success = pooled.success.unwrap();
        assert_eq!((success.successes, success.episodes), (6, 20));
        assert_eq!((success.low, success.high), wilson(6, 20));
        assert!((pooled.mean_of_seeds.unwrap() - 0.3).abs() < 1e-12);
        assert!((pooled.deviation_of_seeds.unwrap() - 0.02_f64.sqrt()).abs() < 1e-12);
        // 0.3 ± 12.7 · 0.141 / √2, as far as a rate can be.
        assert_eq!(pooled.interval_of_seeds, Some((0.0, 1.0)));
        assert_eq!((pooled.kept, pooled.precision), (Some(31.0), Some(0.9)));
        let all = &pooled.auroc[0];
        assert!((all.mean - 0.955).abs() < 1e-12);
        let (low, high) = all.interval.unwrap();
        assert!((low - 0.93).abs() < 1e-12 && (high - 0.97).abs() < 1e-12, "{low} {high}");
    }

    #[test]
    fn seeds_without_a_result_are_not_pooled() {
        let pooled = pool(&[seed(0, Some(8), None), seed(1, None, None)]);
        assert_eq!(pooled.success.map(|rate| rate.episodes), Some(10));
        assert_eq!((pooled.deviation_of_seeds, pooled.interval_of_seeds, pooled.kept), (None, None, None));
        assert_eq!(pool(&[]), Pooled::default());
    }
}
