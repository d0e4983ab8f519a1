//! Similarities to quality scores.

/// q = (w − lo) / (hi − lo), clamped to 0 … 1. `lo` and `hi` are frozen with a score run, so a
/// later segment is measured by the same scale.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Normaliser {
    /// Similarity that becomes 0.
    pub lo: f64,
    /// Similarity that becomes 1.
    pub hi: f64,
}

impl Normaliser {
    /// From the smallest to the largest of `similarities`.
    pub(crate) fn min_max(similarities: impl Iterator<Item = f64>) -> Self {
        let none = Self { lo: f64::INFINITY, hi: f64::NEG_INFINITY };
        similarities.fold(none, |range, w| Self { lo: range.lo.min(w), hi: range.hi.max(w) })
    }

    /// The quality of similarity `w`.
    ///
    /// If all similarities of the run were equal there is no scale: then what is at least as
    /// similar has quality 1 and the rest 0, which is what the clamped line tends to.
    pub fn q(&self, w: f64) -> f32 {
        if w >= self.hi {
            return 1.0;
        }
        if w <= self.lo {
            return 0.0;
        }
        #[expect(clippy::cast_possible_truncation, reason = "between 0 and 1")]
        let q = ((w - self.lo) / (self.hi - self.lo)) as f32;
        q
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;

    #[test]
    fn the_run_spans_zero_to_one_and_later_segments_are_clamped() {
        let normaliser = Normaliser::min_max([-3.0, -1.0, -2.0].into_iter());
        let q = [-3.0, -2.5, -1.0, -9.0, 0.0].map(|w| normaliser.q(w));
        assert_eq!(q, [0.0, 0.25, 1.0, 0.0, 1.0]);
    }

    #[test]
    fn equal_similarities_are_all_good() {
        let normaliser = Normaliser::min_max([-2.0, -2.0].into_iter());
        assert_eq!([-2.0, -1.0, -2.1].map(|w| normaliser.q(w)), [1.0, 1.0, 0.0]);
    }
}
