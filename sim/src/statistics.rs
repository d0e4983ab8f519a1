//! Statistics of an evaluation: how well scores tell good steps from bad, how sure a success rate is.
//!
//! Plain functions over plain numbers; knows no simulator, no server and no tensor.

/// Area under the ROC curve: the chance that a random positive scores higher than a random negative, ties
/// counted half. `None` when one of the two classes is empty or a score is not a number.
#[must_use]
pub fn auroc(scored: &[(f64, bool)]) -> Option<f64> {
    if scored.iter().any(|(score, _)| score.is_nan()) {
        return None;
    }
    let mut sorted: Vec<(f64, bool)> = scored.to_vec();
    sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (mut pairs_won, mut negatives, mut positives) = (0.0_f64, 0.0_f64, 0.0_f64);
    for tied in sorted.chunk_by(|a, b| a.0 == b.0) {
        let (tied_positives, tied_negatives) =
            tied.iter().fold((0.0, 0.0), |(p, n), (_, positive)| if *positive { (p + 1.0, n) } else { (p, n + 1.0) });
        pairs_won += tied_positives * (negatives + tied_negatives / 2.0);
        negatives += tied_negatives;
        positives += tied_positives;
    }
    (negatives > 0.0 && positives > 0.0).then(|| pairs_won / (negatives * positives))
}

/// Precision and recall of the kept items against the good ones, `None` where nothing is kept or nothing is good.
/// Items past the shorter list are ignored.
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

/// The 95 % Wilson score interval of a success rate; `(0, 1)` when nothing was tried.
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
