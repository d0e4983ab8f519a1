//! The comparison of segments with those of experts: its features, its similarity and its scales.

use gleaner_core::Words as _;
use gleaner_core::schema::Shape;

use super::ahead::Ahead;
use super::progress::ProgressForm;

gleaner_core::words! {
    /// Similarity of the features of two segments.
    pub enum Similarity {
        /// Minus the sum over images, proprioception and actions of the Euclidean distance of the last step's features.
        LastL2 = "last_l2",
        /// Sum over images, proprioception and actions of the cosine of the last step's features, less 1 each.
        LastCosine = "last_cosine",
        /// As last_l2, over the features of all the segment's steps, one after the other.
        SegmentL2 = "segment_l2",
        /// As last_cosine, over the features of all the segment's steps, one after the other.
        SegmentCosine = "segment_cosine",
    }
}

impl Similarity {
    /// Whether all steps of the segment count, not only the last.
    pub(crate) fn whole_segment(self) -> bool {
        match self {
            Self::LastL2 | Self::LastCosine => false,
            Self::SegmentL2 | Self::SegmentCosine => true,
        }
    }
}

gleaner_core::words! {
    /// Scaling of the encoder's features.
    pub enum FeatureScale {
        /// Each direction is divided by its variation over the pretraining data.
        Whitened = "whitened",
        /// Unchanged, as in the paper.
        Plain = "plain",
    }
}

gleaner_core::settings! {
    /// Settings of every scorer that compares segments, beside its similarity.
    #[derive(Copy)]
    pub(super) struct NearestSpec {
        /// Scale similarities by the local spread of experts around the match; false: as in the paper.
        pub(super) local_scale: bool = true, Shape::Flag;
        /// Factors of the distances of images, proprioception and actions (0: the modality is ignored).
        pub(super) scale: [f64; 3] = [1.0; 3], Shape::Numbers {
            names: ["image", "proprioception", "action"].map(str::to_owned).to_vec(), least: 0.0, most: 1e6
        };
        /// How the progress of later matches counts, with a lookahead above 0.
        pub(super) progress: ProgressForm = ProgressForm::Pace, ProgressForm::shape();
    }
}

/// The values that are compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Source {
    /// The encoder's features.
    Features(FeatureScale),
    /// Standardised observations and actions.
    Observations,
}

impl Source {
    /// Scaling of the encoder's features, if these are compared.
    pub(super) fn feature_scale(self) -> Option<FeatureScale> {
        match self {
            Self::Features(scale) => Some(scale),
            Self::Observations => None,
        }
    }
}

/// The comparison of segments.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Comparison {
    /// The values that are compared.
    pub(super) source: Source,
    /// The similarity.
    pub(super) similarity: Similarity,
    /// Whether similarities are scaled by the local spread of experts.
    pub(super) local_scale: bool,
    /// Factors of the distances of o, m and a.
    pub(super) scale: [f64; 3],
    /// How far later steps count.
    pub(super) ahead: Ahead,
}

impl Comparison {
    pub(super) fn new(
        source: Source,
        similarity: Similarity,
        [lookahead, lead_in, earliness]: [f64; 3],
        NearestSpec { local_scale, scale, progress }: NearestSpec,
    ) -> Self {
        Self { source, similarity, local_scale, scale, ahead: Ahead { lookahead, progress, lead_in, earliness } }
    }

    /// Whether q depends on how experts compare with each other, so that a single one is scored otherwise.
    pub(super) fn scaled_by_experts(&self) -> bool {
        self.local_scale || self.ahead.counts()
    }
}
