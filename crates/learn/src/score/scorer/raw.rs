//! The scorer `raw`, the default: the nearest expert segment in the observations and actions themselves.

use gleaner_core::kinds::Needs;
use gleaner_core::schema::number_in;
use gleaner_core::{Group as _, Words as _};

use super::{Scorer, ScorerKind};
use crate::score::comparison::{Comparison, NearestSpec, Similarity, Source};

pub(super) const KIND: ScorerKind = ScorerKind {
    name: "raw",
    title: "Raw nearest neighbour",
    about: "The nearest expert segment in standardised images, proprioception and actions, without a network.",
    needs: Needs { encoder: false, history: false, images: true, all_episodes: false },
    settings: || [RawSpec::schema(), NearestSpec::schema()].concat(),
    open: |chosen| {
        let RawSpec { similarity, lookahead } = chosen.read()?;
        Ok(Scorer::Nearest(Comparison::new(Source::Observations, (similarity, lookahead), chosen.read()?)))
    },
};

gleaner_core::settings! {
    /// The comparison of observations and actions.
    struct RawSpec {
        /// Similarity of the features of two segments.
        similarity: Similarity = Similarity::SegmentL2, Similarity::shape();
        /// Share of a mean expert episode within which later steps show whether a segment brings the task forward: q then
        /// counts also how far their matches get ahead. A larger share bridges longer pauses and locates a fault less
        /// precisely; 0: similarity alone, as in the paper.
        lookahead: f64 = 0.5, number_in(0.0, 1.0);
    }
}
