//! The key under which features are stored. Independent of their computation.

use gleaner_core::{Device, ScoreSpec, Words as _};

use super::comparison::{Comparison, Source};
use super::scorer;
use crate::error::LearnError;

/// To be raised with every change of this program or of libtorch that changes the features of the same encoder, episode
/// and settings, and of their form in a store.
const VERSION: u32 = 2;

/// The values that, besides the encoder and the episode, decide a segment's features to the last bit; `None` where
/// storing features costs no less than computing them.
///
/// # Errors
/// [`LearnError::Invalid`] for a scorer that this program does not have.
pub fn features_kind(spec: &ScoreSpec) -> Result<Option<String>, LearnError> {
    // All fields, so that a new one is not overlooked; features do not depend on the comparison.
    let ScoreSpec { scorer, normaliser: _, device, threads } = spec;
    let scorer = scorer::open(scorer)?;
    let Some(Comparison { source: Source::Features(scale), similarity, local_scale: _, scale: _, ahead: _ }) =
        scorer.comparison()
    else {
        return Ok(None);
    };
    let steps = if similarity.whole_segment() { "segment" } else { "last" };
    let device = match device {
        Device::Cpu => processor(),
        Device::Cuda => "cuda f32",
    };
    let threads = threads.unwrap_or_default();
    Ok(Some(format!("{VERSION} {} {steps} {device} {threads}", scale.as_str())))
}

/// The processor features by which libtorch chooses its kernels, whose rounding differs.
fn processor() -> &'static str {
    #[cfg(target_arch = "x86_64")]
    if std::is_x86_feature_detected!("avx512f") {
        return "cpu avx512";
    } else if std::is_x86_feature_detected!("avx2") {
        return "cpu avx2";
    }
    "cpu"
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::score::tests::spec_of;

    #[test]
    fn whatever_changes_features_is_another_kind() {
        let kind = |spec: ScoreSpec| features_kind(&spec).unwrap();
        let ssdf = spec_of("ssdf", &[]);
        let usual = kind(ssdf.clone()).unwrap();
        for other in [
            spec_of("ssdf", &[("similarity", "segment_l2".into())]),
            spec_of("ssdf", &[("feature_scale", "plain".into())]),
            ScoreSpec { device: Device::Cuda, ..ssdf.clone() },
            ScoreSpec { threads: Some(2), ..ssdf },
        ] {
            assert_ne!(kind(other.clone()).unwrap(), usual, "{other:?}");
        }
        let compared_otherwise =
            spec_of("ssdf", &[("similarity", "last_cosine".into()), ("scale", vec![1.0, 2.0, 3.0].into())]);
        assert_eq!(kind(compared_otherwise).unwrap(), usual);
        assert_eq!(kind(spec_of("raw", &[])), None);
    }
}
