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
        let RawSpec { similarity, lookahead, lead_in, earliness } = chosen.read()?;
        let outlook = [lookahead, lead_in, earliness];
        Ok(Scorer::Nearest(Comparison::new(Source::Observations, similarity, outlook, chosen.read()?)))
    },
};

gleaner_core::settings! {
    /// The comparison of observations and actions.
    struct RawSpec {
        /// Similarity of the features of two segments.
        similarity: Similarity = Similarity::SegmentL2, Similarity::shape();
        /// Share of a mean expert episode within which later steps show whether a segment brings the task forward: q then
        /// counts also how their matches get ahead, as `progress` names. A larger share bridges longer pauses and locates a
        /// fault less precisely; 0: similarity alone, as in the paper.
        lookahead: f64 = 0.5, number_in(0.0, 1.0);
        /// Share of a mean expert episode within which a segment is as good as the best one that it leads to: the way back
        /// to what experts do then counts as good. A larger share finds longer ways back and locates the end of a bad
        /// beginning less precisely; 0: its own steps alone, as in the paper.
        lead_in: f64 = 0.2, number_in(0.0, 1.0);
        /// Weight of how early a segment lies in its episode, beside likeness and progress: most failures are good until a
        /// fault and bad after it. A larger weight finds more of what comes before a fault, and keeps more of a bad beginning;
        /// 0: where a segment lies does not count, as in the paper.
        earliness: f64 = 0.2, number_in(0.0, 1.0);
    }
}
