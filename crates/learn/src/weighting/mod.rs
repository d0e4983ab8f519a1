//! The weights of kept imperfect segments in the loss of a policy. One file for each weighting, and its two lines here;
//! must not depend on policies, or on the computation of qualities.

mod kind;
mod quality;
mod uniform;

pub(crate) use kind::Weighting;

use gleaner_core::Chosen;
use gleaner_core::kinds::{Family, Kind};

use crate::error::LearnError;
use crate::family;
use kind::WeightingKind;

/// Every weighting; the first is the default.
const WEIGHTINGS: [&WeightingKind; 2] = [&quality::KIND, &uniform::KIND];

/// The chosen weighting with its settings.
pub(crate) fn open(chosen: &Chosen) -> Result<Weighting, LearnError> {
    (family::find(Family::Weighting, &WEIGHTINGS, |kind| kind.name, &chosen.name)?.open)(chosen)
}

/// Every weighting as data.
pub(crate) fn describe() -> Vec<Kind> {
    WEIGHTINGS.iter().map(|kind| kind.describe()).collect()
}

#[cfg(test)]
mod tests {
    use tch::Tensor;

    use super::*;
    use crate::batch::values;

    fn weights(name: &str, qualities: &[f32]) -> Vec<f32> {
        let chosen = Chosen::new(Family::Weighting, name).unwrap();
        values(&open(&chosen).unwrap().weights(&Tensor::from_slice(qualities)))
    }

    #[test]
    fn a_weighting_gives_each_kept_segment_its_weight() {
        let qualities = [0.0, 0.25, 1.0];
        assert_eq!(weights("quality", &qualities), qualities);
        assert_eq!(weights("uniform", &qualities), [1.0; 3]);
    }

    #[test]
    fn every_weighting_reads_its_lambda_and_0_reads_no_segments() {
        for kind in Family::Weighting.kinds() {
            let of = |lambda: f64| {
                let chosen = Chosen::new(Family::Weighting, &kind.name).unwrap();
                open(&chosen.with(Family::Weighting, "lambda", lambda).unwrap()).unwrap()
            };
            assert!((of(0.3).lambda - 0.3).abs() < 1e-12, "{}", kind.name);
            assert!(of(0.0).ignores_segments() && !of(0.3).ignores_segments(), "{}", kind.name);
        }
    }

    #[test]
    fn an_unknown_weighting_is_rejected_with_the_known_ones() {
        let unknown = Chosen { name: "luck".to_owned(), settings: gleaner_core::Values::new() };
        let message = open(&unknown).map(|_| ()).unwrap_err().to_string();
        assert!(message.contains("supported: quality, uniform"), "{message}");
    }
}
