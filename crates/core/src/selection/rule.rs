//! The rule of a selection: which segments it keeps for their own scores. Must not depend on the segments around them.

use super::Candidate;

/// Which segments are kept for their scores.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Rule {
    /// q > β, the paper's filter; β is in [0, 1].
    Beta(f64),
    /// This part, in (0, 1], of the run's imperfect segments: those of highest q, and among equal q those of highest w.
    TopFraction(f64),
}

/// A rule resolved for one run: decides from one segment's scores whether it is kept.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Filter {
    /// q above this.
    Above(f64),
    /// At least this (q, w): a higher q, or the same q and no lower w.
    AtLeast(f32, f64),
    /// No segment, because the run has no imperfect segment.
    Nothing,
}

impl Filter {
    /// The filter of a rule, given the (q, w) of all the run's imperfect segments. `ranked` goes from best to worst; only
    /// a top fraction reads it.
    ///
    /// A top fraction keeps every segment at least as good as the k-th best, k = ⌈fraction · N⌉, so segments that tie
    /// with the k-th are kept too.
    pub fn new(rule: Rule, ranked: &[(f32, f64)]) -> Self {
        match rule {
            Rule::Beta(beta) => Self::Above(beta),
            Rule::TopFraction(fraction) => {
                ranked.get(rank(fraction, ranked.len()) - 1).map_or(Self::Nothing, |&(q, w)| Self::AtLeast(q, w))
            }
        }
    }

    /// Whether a segment is kept.
    ///
    /// q and β are compared in the precision in which q is stored, so that the rounding of β never keeps a q equal to
    /// β.
    #[expect(clippy::cast_possible_truncation, reason = "rounded on purpose, see above; β is in [0, 1]")]
    pub fn keeps(self, w: f64, q: f32) -> bool {
        match self {
            Self::Above(beta) => q > beta as f32,
            Self::AtLeast(lowest_q, lowest_w) => q > lowest_q || q == lowest_q && w >= lowest_w,
            Self::Nothing => false,
        }
    }
}

/// ⌈fraction · N⌉, at least 1, corrected for the rounding of the product: 7 % of 100 is 7.
#[expect(clippy::cast_precision_loss, reason = "far fewer than 2^52 segments")]
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "between 0 and N")]
pub(super) fn rank(fraction: f64, segments: usize) -> usize {
    ((fraction * segments as f64 * (1.0 - 1e-12)).ceil() as usize).max(1)
}

/// (q, w) of every segment from best to worst, as an argument of [`Filter::new`].
pub fn ranked(candidates: &[Candidate]) -> Vec<(f32, f64)> {
    best_first(candidates.iter().flat_map(|one| one.q.iter().copied().zip(one.w.iter().copied())).collect())
}

/// Sorts (q, w) of segments from best to worst.
pub fn best_first(mut segments: Vec<(f32, f64)>) -> Vec<(f32, f64)> {
    segments.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(b.1.total_cmp(&a.1)));
    segments
}
