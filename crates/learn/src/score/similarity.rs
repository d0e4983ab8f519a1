//! Similarities as the search's metrics.
//!
//! sim(τ_imp, τ_exp) is minus the metric's distance: Σ over o, m, a of −‖z_imp − z_exp‖₂, or of cos(z_imp, z_exp) − 1.
//! `last_*` and `segment_*` differ in the features, not here: z of the last step, or of all the segment's steps
//! concatenated.

use gleaner_search::{Distance, Metric};

use super::comparison::Similarity;

/// The metric of a similarity, with factors of the distances of o, m and a.
pub(super) fn metric(similarity: Similarity, scale: [f64; 3]) -> Metric {
    let kind = match similarity {
        Similarity::LastL2 | Similarity::SegmentL2 => Distance::Euclidean,
        Similarity::LastCosine | Similarity::SegmentCosine => Distance::Angular,
    };
    Metric { kind, scale }
}
