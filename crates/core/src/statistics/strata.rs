//! AUROC within strata: pairs of unlike items, such as steps of a short and a long episode, are not compared.
//!
//! Plain functions over numbers.

use super::{pairs, ranked};

/// An AUROC over pairs within strata.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stratified {
    /// The probability that the positive of a random such pair scores higher, ties counted as half.
    pub auroc: f64,
    /// The number of pairs; strata with one class have none.
    pub pairs: u64,
}

/// The AUROC over the pairs of a positive and a negative of the same stratum; every pair counts alike. `None` without
/// such a pair, or if a score is NaN.
#[must_use]
#[expect(clippy::cast_precision_loss, reason = "counts of pairs are far below 2^52")]
pub fn auroc_within(strata: &[Vec<(f64, bool)>]) -> Option<Stratified> {
    let (mut won, mut count) = (0.0, 0_u64);
    for stratum in strata {
        won += pairs(&ranked(std::iter::once(stratum.as_slice()))?, &[1.0]).0;
        let positives = stratum.iter().filter(|(_, positive)| *positive).count();
        count += positives as u64 * (stratum.len() - positives) as u64;
    }
    (count > 0).then(|| Stratified { auroc: won / count as f64, pairs: count })
}

/// For each value its bin: up to `count` bins of about equally many values, numbered from 0 in ascending order without
/// gaps. Equal values share a bin.
#[must_use]
pub fn quantile_bins(values: &[u64], count: usize) -> Vec<usize> {
    let mut sorted = values.to_vec();
    sorted.sort_unstable();
    // By the middle of the ranks that equal values share.
    let bin = |value: u64| {
        let below = sorted.partition_point(|&other| other < value);
        (below + sorted.partition_point(|&other| other <= value)) * count / (2 * sorted.len())
    };
    let mut used: Vec<usize> = sorted.iter().map(|&value| bin(value)).collect();
    used.dedup();
    values.iter().map(|&value| used.partition_point(|&lower| lower < bin(value))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::statistics::auroc;

    #[test]
    fn pairs_of_different_strata_are_not_counted() {
        // Long episodes are bad and score low; within a length the score is a coin toss.
        let short = vec![(0.9, true), (0.8, true), (0.9, false)];
        let long = vec![(0.1, false), (0.1, true), (0.2, false)];
        assert_eq!(auroc(&[short.clone(), long.clone()].concat()), Some(5.0 / 9.0));
        // Short: tied and lost. Long: tied and lost.
        assert_eq!(auroc_within(&[short.clone(), long]), Some(Stratified { auroc: 1.0 / 4.0, pairs: 4 }));
        assert_eq!(auroc_within(&[short, vec![(0.5, true)]]).map(|found| found.pairs), Some(2));
        assert_eq!(auroc_within(&[vec![(0.5, true)], vec![(0.5, false)]]), None);
        assert_eq!(auroc_within(&[vec![(f64::NAN, true), (0.5, false)]]), None);
        assert_eq!(auroc_within(&[]), None);
    }

    #[test]
    fn one_stratum_gives_the_plain_area() {
        let steps = vec![(0.5, true), (0.2, true), (0.4, false), (0.5, false)];
        assert_eq!(auroc_within(std::slice::from_ref(&steps)).map(|found| found.auroc), auroc(&steps));
    }

    #[test]
    fn bins_are_equally_filled_and_ties_stay_together() {
        assert_eq!(quantile_bins(&[40, 10, 30, 20], 2), [1, 0, 1, 0]);
        // Half of the attempts end at the step limit.
        assert_eq!(quantile_bins(&[60, 60, 60, 12, 25, 31], 3), [2, 2, 2, 0, 0, 1]);
        assert_eq!(quantile_bins(&[60, 60, 60], 5), [0, 0, 0]);
        assert_eq!(quantile_bins(&[7, 9], 1), [0, 0]);
        assert!(quantile_bins(&[], 3).is_empty());
    }
}
