//! Agreement of rankings: Spearman's correlation, and the overlap of two selections.
//!
//! Plain functions over numbers.

/// The rank of each value, from 1 for the lowest; tied values share the mean of their ranks. `None` if a value is NaN.
#[must_use]
#[expect(clippy::cast_precision_loss, reason = "counts of segments are far below 2^52")]
pub fn mid_ranks(values: &[f64]) -> Option<Vec<f64>> {
    if values.iter().any(|value| value.is_nan()) {
        return None;
    }
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_unstable_by(|&a, &b| values[a].total_cmp(&values[b]));
    let (mut ranks, mut below) = (vec![0.0; values.len()], 0_usize);
    for tied in order.chunk_by(|&a, &b| values[a] == values[b]) {
        let rank = below as f64 + (tied.len() + 1) as f64 / 2.0;
        for &place in tied {
            ranks[place] = rank;
        }
        below += tied.len();
    }
    Some(ranks)
}

/// Spearman's rank correlation of paired values, −1 to 1: Pearson's correlation of their [`mid_ranks`]. `None` for lists
/// of different lengths or of fewer than two values, if all values of a list are equal, or if one is NaN.
#[must_use]
#[expect(clippy::cast_precision_loss, reason = "counts of segments are far below 2^52")]
pub fn spearman(one: &[f64], other: &[f64]) -> Option<f64> {
    if one.len() != other.len() || one.len() < 2 {
        return None;
    }
    let (one, other) = (mid_ranks(one)?, mid_ranks(other)?);
    // Ties keep the sum of the ranks.
    let middle = (one.len() + 1) as f64 / 2.0;
    let (mut both, mut of_one, mut of_other) = (0.0, 0.0, 0.0);
    for (a, b) in one.iter().zip(&other) {
        both += (a - middle) * (b - middle);
        of_one += (a - middle).powi(2);
        of_other += (b - middle).powi(2);
    }
    (of_one > 0.0 && of_other > 0.0).then(|| (both / (of_one * of_other).sqrt()).clamp(-1.0, 1.0))
}

/// The overlap of two selections of the same items: the share of the items in either that are in both (Jaccard). `None`
/// if both are empty. Items beyond the shorter list are ignored.
#[must_use]
#[expect(clippy::cast_precision_loss, reason = "counts of segments are far below 2^52")]
pub fn jaccard(one: &[bool], other: &[bool]) -> Option<f64> {
    let (mut both, mut either) = (0_u64, 0_u64);
    for (&a, &b) in one.iter().zip(other) {
        both += u64::from(a && b);
        either += u64::from(a || b);
    }
    (either > 0).then(|| both as f64 / either as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn near(found: Option<f64>, expected: f64) {
        assert!(found.is_some_and(|found| (found - expected).abs() < 1e-12), "{found:?}, expected {expected}");
    }

    #[test]
    fn tied_values_share_the_mean_of_their_ranks() {
        assert_eq!(mid_ranks(&[3.0, 1.0, 3.0, 2.0, 3.0]), Some(vec![4.0, 1.0, 4.0, 2.0, 4.0]));
        assert_eq!(mid_ranks(&[0.0, -0.0]), Some(vec![1.5, 1.5]));
        assert_eq!((mid_ranks(&[]), mid_ranks(&[1.0, f64::NAN])), (Some(vec![]), None));
    }

    #[test]
    fn spearman_depends_on_ranks_alone() {
        near(spearman(&[1.0, 2.0, 3.0], &[-5.0, 0.0, 1e9]), 1.0);
        near(spearman(&[1.0, 2.0, 3.0], &[3.0, 2.0, 1.0]), -1.0);
        // Without ties 1 − 6 Σd² / (n (n² − 1)); d² = 0, 1, 1, 0: 1 − 12 / 60.
        near(spearman(&[1.0, 2.0, 3.0, 4.0], &[10.0, 30.0, 20.0, 40.0]), 0.8);
        // Ranks 1.5, 1.5, 3 and 1, 2, 3: covariance 1.5, variances 1.5 and 2.
        near(spearman(&[0.0, 0.0, 7.0], &[1.0, 2.0, 3.0]), 1.5 / 3.0_f64.sqrt());
    }

    #[test]
    fn values_correlate_with_themselves_exactly() {
        for count in 2u8..200 {
            let values: Vec<f64> = (0..count).map(|at| f64::from(at % 7)).collect();
            assert_eq!(spearman(&values, &values), Some(1.0), "{count}");
        }
    }

    #[test]
    fn constant_or_unpaired_values_have_no_correlation() {
        assert_eq!(spearman(&[1.0, 1.0], &[1.0, 2.0]), None);
        assert_eq!(spearman(&[1.0], &[1.0]), None);
        assert_eq!(spearman(&[1.0, 2.0], &[1.0, 2.0, 3.0]), None);
        assert_eq!(spearman(&[1.0, f64::NAN], &[1.0, 2.0]), None);
    }

    #[test]
    fn overlap_is_the_shared_part_of_the_union() {
        near(jaccard(&[true, true, false, false], &[true, false, true, false]), 1.0 / 3.0);
        near(jaccard(&[true, false], &[true, false]), 1.0);
        near(jaccard(&[true, false], &[false, true]), 0.0);
        assert_eq!(jaccard(&[false], &[false]), None);
    }
}
