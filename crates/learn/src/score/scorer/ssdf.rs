//! The scorer `ssdf`, the paper's: the nearest expert segment in the encoder's features.

use gleaner_core::Group as _;
use gleaner_core::Words as _;
use gleaner_core::kinds::Needs;

use super::{Scorer, ScorerKind};
use crate::score::comparison::{Comparison, FeatureScale, NearestSpec, Similarity, Source};

pub(super) const KIND: ScorerKind = ScorerKind {
    name: "ssdf",
    title: "SSDF",
    about: "The nearest expert segment in the encoder's features: the paper's method.",
    needs: Needs { encoder: true, history: false, images: true, all_episodes: false },
    settings: || [FeatureSpec::schema(), NearestSpec::schema()].concat(),
    open: |chosen| {
        let FeatureSpec { feature_scale, similarity } = chosen.read()?;
        Ok(Scorer::Nearest(Comparison::new(Source::Features(feature_scale), similarity, chosen.read()?)))
    },
};

gleaner_core::settings! {
    /// The features that are compared.
    struct FeatureSpec {
        /// Scaling of the features before they are compared.
        feature_scale: FeatureScale = FeatureScale::Whitened, FeatureScale::shape();
        /// Similarity of the features of two segments.
        similarity: Similarity = Similarity::LastL2, Similarity::shape();
    }
}
