//! The weighting `uniform`, a baseline: kept segments count alike. The comparison with it shows the value of weights
//! beyond that of the selection.

use gleaner_core::Group as _;

use super::kind::{Added, Weighting, WeightingKind};

pub(super) const KIND: WeightingKind = WeightingKind {
    name: "uniform",
    title: "Uniform",
    about: "A baseline: all kept segments count alike, times λ, whatever their quality.",
    settings: Added::schema,
    open: |chosen| Ok(Weighting { lambda: chosen.read::<Added>()?.lambda, of_quality: tch::Tensor::ones_like }),
};
