//! The weighting `quality`, the paper's: L_full = E_{D_e}[−log P] + λ E_{D_f}[−q log P].

use gleaner_core::Group as _;

use super::kind::{Added, Weighting, WeightingKind};

pub(super) const KIND: WeightingKind = WeightingKind {
    name: "quality",
    title: "Quality",
    about: "The weighting of the paper: each kept segment counts by its quality q, times λ.",
    settings: Added::schema,
    open: |chosen| Ok(Weighting { lambda: chosen.read::<Added>()?.lambda, of_quality: tch::Tensor::shallow_clone }),
};
