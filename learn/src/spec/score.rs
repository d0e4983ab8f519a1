//! The settings of a score run.

use serde::{Deserialize, Serialize};

use super::run::validate_run;
use super::{Device, within};
use crate::error::LearnError;

/// How two segments' features are compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Similarity {
    /// Negative sum over o, m, a of the Euclidean distance between last-step features.
    #[default]
    LastL2,
}

/// How similarities become quality scores.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum NormaliserKind {
    /// Smallest and largest similarity of the run's imperfect segments become 0 and 1.
    #[default]
    MinMax,
}

/// Settings of [`score`](fn@crate::score).
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ScoreSpec {
    /// How segments are compared.
    pub similarity: Similarity,
    /// How similarities become scores.
    pub normaliser: NormaliserKind,
    /// Factors of the o, m and a distances; unset means 1, 1, 1 as in the paper.
    pub modality_scale: Option<[f64; 3]>,
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

    /// Factors of the o, m and a distances.
    pub(crate) fn scale(&self) -> [f64; 3] {
        self.modality_scale.unwrap_or([1.0; 3])
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;

    #[test]
    fn a_scale_that_counts_nothing_is_refused() {
        let spec = ScoreSpec { modality_scale: Some([0.0; 3]), ..ScoreSpec::default() };
        assert!(spec.validate().is_err());
    }
}
