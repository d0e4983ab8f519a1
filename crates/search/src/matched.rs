//! The nearest point of a query, and the order of candidates. Must not depend on the search.

use crate::points::PARTS;

/// A query's nearest point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Match {
    /// The number of its group.
    pub group: u32,
    /// Its row within the group.
    pub row: u32,
    /// The distance under the index's metric, exact to double precision.
    pub distance: f64,
    /// The distance in each part, before any scale.
    pub parts: [f32; PARTS],
}

impl Match {
    /// Whether this match is nearer, or equally near and of an earlier group, or of the same group and an earlier row.
    pub(crate) fn beats(&self, other: &Option<Self>) -> bool {
        let order = |found: &Self| (found.distance, found.group, found.row);
        other.as_ref().is_none_or(|other| order(self) < order(other))
    }
}
