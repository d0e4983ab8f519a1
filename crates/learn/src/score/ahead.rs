//! How far later steps, and the place of a segment, count. Plain values; the measure gives them their meaning.

use super::progress::ProgressForm;

/// Shares of a mean expert episode; 0: later steps do not count.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Ahead {
    /// Δ, within which later matches count as progress.
    pub(super) lookahead: f64,
    /// How their progress counts.
    pub(super) progress: ProgressForm,
    /// L, within which a segment is as good as the best one that it leads to.
    pub(super) lead_in: f64,
    /// The weight of how early a segment lies in its episode; 0: where it lies does not count.
    pub(super) earliness: f64,
}

impl Ahead {
    /// Whether a later step or the place of a segment counts.
    pub(super) fn counts(self) -> bool {
        self.lookahead > 0.0 || self.lead_in > 0.0 || self.earliness > 0.0
    }
}
