//! Similarities as the search's metrics.
//!
//! sim(τ_imp, τ_exp) is minus the metric's distance: Σ over o, m, a of −‖z_imp − z_exp‖₂, or of cos(z_imp, z_exp) − 1.
//! `last_*` and `segment_*` differ in the features, not here: z of the last step, or of all the segment's steps one
//! after the other.

use gleaner_search::{Distance, Metric};

use crate::spec::{ScoreSpec, Similarity};

/// The metric of the similarity in `spec`.
pub(super) fn metric(spec: &ScoreSpec) -> Metric {
    let kind = match spec.similarity {
        Similarity::LastL2 | Similarity::SegmentL2 => Distance::Euclidean,
        Similarity::LastCosine | Similarity::SegmentCosine => Distance::Angular,
    };
    Metric { kind, scale: spec.scale() }
}
