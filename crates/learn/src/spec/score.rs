//! The settings of a score run.

use serde::{Deserialize, Serialize};

use super::run::validate_run;
use super::{Device, within};
use crate::error::LearnError;

/// What gives segments their score.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Scorer {
    /// The nearest expert segment in the encoder's features: the paper's method.
    #[default]
    Ssdf,
    /// A baseline: the nearest expert segment in standardised o, m and a themselves; the network
    /// is not run.
    Raw,
    /// A baseline: a small network that tells experts' steps from imperfect ones.
    Classifier,
}

impl Scorer {
    /// The word for it in specs and reports.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Ssdf => "ssdf",
            Self::Raw => "raw",
            Self::Classifier => "classifier",
        }
    }
}

/// How two segments' features are compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Similarity {
    /// Negative sum over o, m, a of the Euclidean distance between last-step features.
    #[default]
    LastL2,
    /// Sum over o, m, a of the cosine between last-step features, less 1 each.
    LastCosine,
    /// As `LastL2`, over the features of all the segment's steps, one after the other.
    SegmentL2,
    /// As `LastCosine`, over the features of all the segment's steps, one after the other.
    SegmentCosine,
}

impl Similarity {
    /// The word for it in specs and reports.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::LastL2 => "last_l2",
            Self::LastCosine => "last_cosine",
            Self::SegmentL2 => "segment_l2",
            Self::SegmentCosine => "segment_cosine",
        }
    }

    /// Whether all steps of the segment count, not only the last.
    pub(crate) fn whole_segment(self) -> bool {
        match self {
            Self::LastL2 | Self::LastCosine => false,
            Self::SegmentL2 | Self::SegmentCosine => true,
        }
    }
}

/// What features are measured in before they are compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FeatureScale {
    /// Every direction by how much it varies over the pretraining data.
    #[default]
    Whitened,
    /// As the transformer gives them: the paper to the letter.
    Plain,
}

impl FeatureScale {
    /// The word for it in specs and reports.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Whitened => "whitened",
            Self::Plain => "plain",
        }
    }
}

/// What a similarity is measured against before it is normalised.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Yardstick {
    /// How near experts are to one another around the match.
    #[default]
    Local,
    /// Nothing: q = norm(w), the paper to the letter.
    None,
}

impl Yardstick {
    /// The word for it in specs and reports.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Local => "local",
            Self::None => "none",
        }
    }
}

/// How similarities become quality scores.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum NormaliserKind {
    /// Smallest and largest similarity of the run's imperfect segments become 0 and 1.
    // As job records of the first version have it.
    #[default]
    #[serde(alias = "min_max")]
    MinMax,
    /// The share of the run's imperfect segments that are less similar.
    Quantile,
}

impl NormaliserKind {
    /// The word for it in specs and reports.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::MinMax => "minmax",
            Self::Quantile => "quantile",
        }
    }
}

/// Settings of [`score`](fn@crate::score).
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ScoreSpec {
    /// What gives the scores.
    pub scorer: Scorer,
    /// How segments are compared; the classifier compares none.
    pub similarity: Similarity,
    /// What features are measured in.
    pub feature_scale: FeatureScale,
    /// What similarities are measured against.
    pub yardstick: Yardstick,
    /// How similarities become scores.
    pub normaliser: NormaliserKind,
    /// Factors of the o, m and a distances; unset means 1, 1, 1 as in the paper.
    pub modality_scale: Option<[f64; 3]>,
    /// Of the classifier's random numbers; nearest segments need none.
    pub seed: u64,
    /// Where to run.
    pub device: Device,
    /// Intra-op threads; unset leaves the process as it is.
    pub threads: Option<u32>,
}

impl ScoreSpec {
    /// Checks every field.
    ///
    /// # Errors
    /// [`LearnError::Invalid`] naming the field.
    pub fn validate(&self) -> Result<(), LearnError> {
        let scale = self.scale();
        for (i, factor) in scale.iter().enumerate() {
            within(&format!("modality_scale[{i}]"), *factor, 0.0, 1e6)?;
        }
        if scale.iter().all(|factor| *factor == 0.0) {
            return Err(LearnError::invalid("modality_scale", "is zero for every modality; at least one must count"));
        }
        validate_run(1, self.threads)
    }

    /// Fails if a setting is other than its default though the scorer never looks at it. For what a caller asks; what an
    /// earlier version kept stays valid.
    ///
    /// # Errors
    /// [`LearnError::Invalid`] naming the field.
    pub fn refuse_unused(&self) -> Result<(), LearnError> {
        let default = Self::default();
        let compares = [
            ("similarity", self.similarity != default.similarity),
            ("feature_scale", self.feature_scale != default.feature_scale),
            ("yardstick", self.yardstick != default.yardstick),
            ("modality_scale", self.scale() != default.scale()),
        ];
        let (unused, why): (&[&str], _) = match self.scorer {
            Scorer::Ssdf => (&[], ""),
            Scorer::Raw => (&["feature_scale"], "compares observations, not features"),
            Scorer::Classifier => {
                (&["similarity", "feature_scale", "yardstick", "modality_scale"], "compares no segments")
            }
        };
        match compares.iter().find(|(field, set)| *set && unused.contains(field)) {
            Some((field, _)) => {
                let scorer = self.scorer.as_str();
                Err(LearnError::invalid(*field, format!("has no effect: the scorer {scorer} {why}; leave it out")))
            }
            None => Ok(()),
        }
    }

    /// Factors of the o, m and a distances.
    pub(crate) fn scale(&self) -> [f64; 3] {
        self.modality_scale.unwrap_or([1.0; 3])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scale_that_counts_nothing_is_refused() {
        let spec = ScoreSpec { modality_scale: Some([0.0; 3]), ..ScoreSpec::default() };
        assert!(spec.validate().is_err());
    }

    #[test]
    fn what_a_scorer_never_looks_at_is_refused() {
        let classifier = || ScoreSpec { scorer: Scorer::Classifier, ..ScoreSpec::default() };
        let raw = || ScoreSpec { scorer: Scorer::Raw, ..ScoreSpec::default() };
        for (spec, field) in [
            (ScoreSpec { feature_scale: FeatureScale::Plain, ..raw() }, "feature_scale: "),
            (ScoreSpec { feature_scale: FeatureScale::Plain, ..classifier() }, "feature_scale: "),
            (ScoreSpec { similarity: Similarity::SegmentL2, ..classifier() }, "similarity: "),
            (ScoreSpec { yardstick: Yardstick::None, ..classifier() }, "yardstick: "),
            (ScoreSpec { modality_scale: Some([1.0, 2.0, 1.0]), ..classifier() }, "modality_scale: "),
        ] {
            let message = spec.refuse_unused().unwrap_err().to_string();
            assert!(message.starts_with(field) && message.contains("leave it out"), "{message}");
            assert!(spec.validate().is_ok(), "it can still be read");
            assert!(ScoreSpec { scorer: Scorer::Ssdf, ..spec }.refuse_unused().is_ok());
        }
        let normaliser = NormaliserKind::Quantile;
        let compared = (Similarity::SegmentCosine, Yardstick::None, Some([0.5; 3]));
        let (similarity, yardstick, modality_scale) = compared;
        let raw = ScoreSpec { similarity, yardstick, modality_scale, normaliser, ..raw() };
        assert!(raw.refuse_unused().is_ok());
        assert!(ScoreSpec { normaliser, seed: 7, ..classifier() }.refuse_unused().is_ok());
    }

    #[test]
    fn the_words_in_specs_are_the_words_in_reports() {
        let word = |value: serde_json::Value| value.as_str().unwrap().to_owned();
        for scorer in [Scorer::Ssdf, Scorer::Raw, Scorer::Classifier] {
            assert_eq!(word(serde_json::to_value(scorer).unwrap()), scorer.as_str());
        }
        for similarity in [Similarity::LastL2, Similarity::LastCosine, Similarity::SegmentL2, Similarity::SegmentCosine]
        {
            assert_eq!(word(serde_json::to_value(similarity).unwrap()), similarity.as_str());
        }
        for kind in [NormaliserKind::MinMax, NormaliserKind::Quantile] {
            assert_eq!(word(serde_json::to_value(kind).unwrap()), kind.as_str());
        }
    }
}
