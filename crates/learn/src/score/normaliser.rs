//! Similarities to quality scores.

use crate::error::LearnError;
use gleaner_core::NormaliserKind;

/// Number of stored quantiles: evenly spaced from the smallest to the largest similarity.
const QUANTILES: usize = 1001;

/// q(τ_imp) = norm(w(τ_imp)) ∈ [0, 1], frozen with a score run, so that later segments have the same scale. With a
/// local scale ρ, w here is w / ρ, and where later steps count it is the measure that joins it with them.
///
/// `minmax`: q = (w − lo) / (hi − lo), clamped to 0 … 1. `quantile`: the share of the run's imperfect segments with a
/// smaller w. `calibrated`: the share of the run's expert segments, each compared with the other experts, with a w at
/// most as large; so an expert's own q is uniform, and q means the same in every run. Shares are interpolated linearly
/// between `quantiles`.
#[derive(Debug, Clone, PartialEq)]
pub struct Normaliser {
    /// The kind of normaliser.
    pub kind: NormaliserKind,
    /// The smallest similarity of the run's imperfect segments, or of its experts for `calibrated`; it maps to 0.
    pub lo: f64,
    /// The largest similarity; it maps to 1.
    pub hi: f64,
    /// 1001 evenly spaced quantiles of the similarities, low to high; empty for `minmax`.
    pub quantiles: Vec<f64>,
}

impl Normaliser {
    /// The normaliser of `kind` over `similarities`, those of the segments that it refers to.
    pub(crate) fn fit(kind: NormaliserKind, mut similarities: Vec<f64>) -> Self {
        similarities.sort_by(f64::total_cmp);
        let quantiles = match kind {
            NormaliserKind::MinMax => Vec::new(),
            NormaliserKind::Quantile | NormaliserKind::Calibrated => {
                (0..QUANTILES).map(|k| quantile(&similarities, k)).collect()
            }
        };
        let (lo, hi) = (similarities.first(), similarities.last());
        Self { kind, lo: lo.copied().unwrap_or(0.0), hi: hi.copied().unwrap_or(0.0), quantiles }
    }

    /// The quality of similarity `w`.
    ///
    /// The largest similarity of the run always maps to 1. If all were equal there is no scale: a similarity at least
    /// as high then maps to 1 and a lower one to 0, the limit of the clamped line.
    pub fn q(&self, w: f64) -> f32 {
        if w >= self.hi {
            return 1.0;
        }
        if w < self.lo {
            return 0.0;
        }
        let q = match self.kind {
            NormaliserKind::MinMax => (w - self.lo) / (self.hi - self.lo),
            NormaliserKind::Quantile => self.share(w, self.quantiles.partition_point(|quantile| *quantile < w)),
            NormaliserKind::Calibrated => self.share(w, self.quantiles.partition_point(|quantile| *quantile <= w)),
        };
        #[expect(clippy::cast_possible_truncation, reason = "between 0 and 1")]
        let q = q as f32;
        q
    }

    /// The similarity of this share, 0 … 1: the inverse of `q` for `quantile` and `calibrated`.
    pub(super) fn at_share(&self, share: f32) -> f64 {
        #[expect(clippy::cast_precision_loss, reason = "about a thousand")]
        let place = f64::from(share) * self.quantiles.len().saturating_sub(1) as f64;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "between 0 and a thousand")]
        let below = place.floor() as usize;
        let begin = self.quantiles.get(below).copied().unwrap_or(self.hi);
        let next = self.quantiles.get(below + 1).copied().unwrap_or(begin);
        begin + (next - begin) * place.fract()
    }

    /// The rank of `w` among the quantiles, 0 … 1, of which number `above` is the next one above. On a flat stretch it
    /// is the lower end for `quantile`, because an equal similarity is not a lower one, and the upper end for
    /// `calibrated`.
    fn share(&self, w: f64, above: usize) -> f64 {
        let (Some(below), Some(next)) = (above.checked_sub(1), self.quantiles.get(above)) else {
            return if above == 0 { 0.0 } else { 1.0 };
        };
        let begin = self.quantiles[below];
        #[expect(clippy::cast_precision_loss, reason = "about a thousand")]
        let share = (below as f64 + (w - begin) / (next - begin)) / (self.quantiles.len() - 1) as f64;
        share
    }

    /// Fails unless this is a possible normaliser of a run.
    pub(crate) fn validate(&self, field: &str) -> Result<(), LearnError> {
        let wrong = |message: &str| Err(LearnError::invalid(field, message));
        if !(self.lo.is_finite() && self.hi.is_finite() && self.lo <= self.hi) {
            return wrong("must have finite lo and hi, lo at most hi");
        }
        let wanted = match self.kind {
            NormaliserKind::MinMax => 0,
            NormaliserKind::Quantile | NormaliserKind::Calibrated => QUANTILES,
        };
        if self.quantiles.len() != wanted {
            return wrong(&format!("has {} quantiles, {wanted} belong to its kind", self.quantiles.len()));
        }
        let rising = self.quantiles.is_sorted() && self.quantiles.iter().all(|quantile| quantile.is_finite());
        if rising { Ok(()) } else { wrong("must have finite quantiles from low to high") }
    }
}

/// Quantile `k` of [`QUANTILES`] of `sorted`, interpolated linearly between neighbours.
#[expect(clippy::cast_precision_loss, reason = "far fewer segments than 2^52")]
fn quantile(sorted: &[f64], k: usize) -> f64 {
    let (Some(steps), last) = (sorted.len().checked_sub(1), QUANTILES - 1) else { return 0.0 };
    let (place, rest) = (k * steps / last, k * steps % last);
    let begin = sorted[place];
    let end = sorted.get(place + 1).copied().unwrap_or(begin);
    (begin + (end - begin) * (rest as f64 / last as f64)).clamp(begin, end)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fit(kind: NormaliserKind, similarities: &[f64]) -> Normaliser {
        let normaliser = Normaliser::fit(kind, similarities.to_vec());
        normaliser.validate("normaliser").unwrap();
        normaliser
    }

    #[test]
    fn the_run_spans_zero_to_one_and_later_segments_are_clamped() {
        let normaliser = fit(NormaliserKind::MinMax, &[-3.0, -1.0, -2.0]);
        let q = [-3.0, -2.5, -1.0, -9.0, 0.0].map(|w| normaliser.q(w));
        assert_eq!(q, [0.0, 0.25, 1.0, 0.0, 1.0]);
    }

    #[test]
    fn equal_similarities_are_all_good() {
        for kind in [NormaliserKind::MinMax, NormaliserKind::Quantile, NormaliserKind::Calibrated] {
            let normaliser = fit(kind, &[-2.0, -2.0]);
            assert_eq!([-2.0, -1.0, -2.1].map(|w| normaliser.q(w)), [1.0, 1.0, 0.0]);
        }
    }

    #[test]
    fn quantiles_are_shares_and_an_outlier_does_not_squeeze_the_rest() {
        let mut similarities: Vec<f64> = (0..=100).map(|i| -f64::from(i)).collect();
        similarities[100] = -1e6;
        let normaliser = fit(NormaliserKind::Quantile, &similarities);
        assert_eq!((normaliser.lo, normaliser.hi, normaliser.quantiles.len()), (-1e6, 0.0, 1001));
        for (w, expected) in [(-50.0, 0.5), (-10.0, 0.9), (-9.5, 0.905), (0.0, 1.0), (-1e6, 0.0), (-2e6, 0.0)] {
            assert!((normaliser.q(w) - expected).abs() < 1e-6, "{w}");
        }
    }

    #[test]
    fn a_quantile_of_equals_is_the_share_below_them() {
        let mut similarities = vec![-1.0; 60];
        similarities.extend([-2.0; 30]);
        similarities.extend((0..11).map(|i| -f64::from(i) / 20.0));
        let normaliser = fit(NormaliserKind::Quantile, &similarities);
        assert_eq!(normaliser.q(-2.0), 0.0);
        assert!((normaliser.q(-1.0) - 0.3).abs() < 2e-3);
        let q: Vec<f32> = (0..200).map(|i| normaliser.q(-f64::from(i) / 90.0)).collect();
        assert!(q.is_sorted_by(|a, b| a >= b));
    }

    #[test]
    fn a_calibrated_quality_is_the_share_of_experts_at_least_as_far() {
        let experts: Vec<f64> = (1..=100).map(|i| -f64::from(i)).collect();
        let normaliser = fit(NormaliserKind::Calibrated, &experts);
        let q: Vec<f32> = experts.iter().map(|w| normaliser.q(*w)).collect();
        let mean = q.iter().sum::<f32>() / 100.0;
        assert!((mean - 0.5).abs() < 0.01, "an expert's own quality is uniform: {mean}");
        assert!((normaliser.q(-50.5) - 0.5).abs() < 1e-6);
        assert_eq!([0.0, -101.0].map(|w| normaliser.q(w)), [1.0, 0.0]);
        // Of equals, all are at least as far.
        let equal = [vec![-3.0; 30], vec![-2.0; 40], vec![-1.0; 30]].concat();
        let normaliser = fit(NormaliserKind::Calibrated, &equal);
        for (w, share) in [(-2.0, 0.7), (-3.0, 0.3)] {
            assert!((normaliser.q(w) - share).abs() < 0.01, "{w}: {}", normaliser.q(w));
        }
    }

    #[test]
    fn a_normaliser_no_run_found_is_refused() {
        let good = fit(NormaliserKind::Quantile, &[-2.0, -1.0]);
        for bad in [
            Normaliser { lo: f64::NAN, ..good.clone() },
            Normaliser { lo: 0.0, ..good.clone() },
            Normaliser { quantiles: Vec::new(), ..good.clone() },
            Normaliser { kind: NormaliserKind::MinMax, ..good.clone() },
            Normaliser { quantiles: vec![f64::NAN; 1001], ..good.clone() },
        ] {
            let message = bad.validate("base.normaliser").unwrap_err().to_string();
            assert!(message.starts_with("base.normaliser: "), "{message}");
        }
    }
}
