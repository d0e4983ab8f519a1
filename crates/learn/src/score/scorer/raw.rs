//! The scorer `raw`, the default: the nearest expert segment in the observations and actions themselves.

use gleaner_core::kinds::Needs;
use gleaner_core::{Chosen, Group as _, Words as _};

use super::{Scorer, ScorerKind};
use crate::error::LearnError;
use crate::score::comparison::{Comparison, NearestSpec, Similarity, Source};

pub(super) const KIND: ScorerKind = ScorerKind {
    name: "raw",
    title: "Raw nearest neighbour",
    about: "The nearest expert segment in standardised images, proprioception and actions, without a network.",
    needs: Needs { encoder: false, history: false, images: true, all_episodes: false },
    settings: || [RawSpec::schema(), NearestSpec::schema()].concat(),
    open: |chosen| Ok(Scorer::Nearest(comparison(chosen)?)),
};

/// The comparison of observations and actions by these settings.
pub(super) fn comparison(chosen: &Chosen) -> Result<Comparison, LearnError> {
    let RawSpec { similarity } = chosen.read()?;
    Ok(Comparison::new(Source::Observations, similarity, chosen.read()?))
}

gleaner_core::settings! {
    /// The observations and actions that are compared.
    pub(super) struct RawSpec {
        /// Similarity of the features of two segments.
        similarity: Similarity = Similarity::SegmentL2, Similarity::shape();
    }
}
