//! Scoring on the wire.

use gleaner_learn::{FeatureScale, NormaliserKind, ScoreSpec, Scorer, Similarity, Yardstick};
use gleaner_proto::v1;

use super::settings::{device_from, device_to, optional_snapshot, refused, unknown};
use crate::{
    domain::{
        id::{EncoderId, ScoreRunId},
        order::JobOrder,
    },
    error::{Error, Result},
};

pub(super) fn order(at: &str, spec: v1::ScoreSpec) -> Result<JobOrder> {
    let extends = match spec.extends.as_str() {
        "" => None,
        id => Some(ScoreRunId::parse(&format!("{at}.extends"), id)?),
    };
    let encoder_id = match spec.encoder_id.as_str() {
        "" if extends.is_some() => None,
        id => Some(EncoderId::parse(&format!("{at}.encoder_id"), id)?),
    };
    let snapshot_id = optional_snapshot(at, &spec.snapshot_id)?;
    Ok(JobOrder::Score { encoder_id, snapshot_id, extends, spec: settings_from(at, &spec)? })
}

/// How a pipeline scores; what to score it knows itself.
pub(super) fn of_pipeline(at: &str, spec: &v1::ScoreSpec) -> Result<ScoreSpec> {
    for (name, id) in [("encoder_id", &spec.encoder_id), ("snapshot_id", &spec.snapshot_id), ("extends", &spec.extends)]
    {
        if !id.is_empty() {
            return Err(Error::invalid(
                &format!("{at}.{name}"),
                "must be left out: the pipeline scores its own encoder's snapshot",
            ));
        }
    }
    settings_from(at, spec)
}

fn settings_from(at: &str, spec: &v1::ScoreSpec) -> Result<ScoreSpec> {
    let v1::ScoreSpec {
        encoder_id: _,
        snapshot_id: _,
        extends: _,
        device,
        scorer,
        similarity,
        normaliser,
        modality_scale,
        seed,
        feature_scale,
        yardstick,
    } = spec;
    let spec = ScoreSpec {
        scorer: match v1::Scorer::try_from(*scorer) {
            Ok(v1::Scorer::Unspecified | v1::Scorer::Ssdf) => Scorer::Ssdf,
            Ok(v1::Scorer::Raw) => Scorer::Raw,
            Ok(v1::Scorer::Classifier) => Scorer::Classifier,
            Err(_) => return Err(unknown(at, "scorer")),
        },
        similarity: match v1::Similarity::try_from(*similarity) {
            Ok(v1::Similarity::Unspecified | v1::Similarity::LastL2) => Similarity::LastL2,
            Ok(v1::Similarity::LastCosine) => Similarity::LastCosine,
            Ok(v1::Similarity::SegmentL2) => Similarity::SegmentL2,
            Ok(v1::Similarity::SegmentCosine) => Similarity::SegmentCosine,
            Err(_) => return Err(unknown(at, "similarity")),
        },
        feature_scale: match v1::FeatureScale::try_from(*feature_scale) {
            Ok(v1::FeatureScale::Unspecified | v1::FeatureScale::Whitened) => FeatureScale::Whitened,
            Ok(v1::FeatureScale::Plain) => FeatureScale::Plain,
            Err(_) => return Err(unknown(at, "feature_scale")),
        },
        yardstick: match v1::Yardstick::try_from(*yardstick) {
            Ok(v1::Yardstick::Unspecified | v1::Yardstick::Local) => Yardstick::Local,
            Ok(v1::Yardstick::None) => Yardstick::None,
            Err(_) => return Err(unknown(at, "yardstick")),
        },
        normaliser: match v1::Normaliser::try_from(*normaliser) {
            Ok(v1::Normaliser::Unspecified | v1::Normaliser::Minmax) => NormaliserKind::MinMax,
            Ok(v1::Normaliser::Quantile) => NormaliserKind::Quantile,
            Err(_) => return Err(unknown(at, "normaliser")),
        },
        modality_scale: modality_scale
            .map(|v1::ModalityScale { image, proprioception, action }| [image, proprioception, action]),
        seed: *seed,
        device: device_from(at, *device)?,
        ..ScoreSpec::default()
    };
    spec.validate().and_then(|()| spec.refuse_unused()).map_err(|error| named(refused(at, error), at))?;
    Ok(spec)
}

/// The factors have names on the wire, not places.
fn named(error: Error, at: &str) -> Error {
    let places = [("[0]", ".image"), ("[1]", ".proprioception"), ("[2]", ".action")];
    let scale = format!("{at}.modality_scale");
    let found = places.iter().find_map(|(place, name)| {
        let rest = error.message().strip_prefix(&format!("{scale}{place}: "))?;
        Some(Error::invalid(&format!("{scale}{name}"), rest))
    });
    found.unwrap_or(error)
}

/// The settings, without what is scored.
pub(super) fn to_proto(spec: ScoreSpec) -> v1::ScoreSpec {
    let ScoreSpec {
        scorer,
        similarity,
        feature_scale,
        yardstick,
        normaliser,
        modality_scale,
        seed,
        device,
        threads: _,
    } = spec;
    v1::ScoreSpec {
        device: device_to(device),
        scorer: match scorer {
            Scorer::Ssdf => v1::Scorer::Ssdf.into(),
            Scorer::Raw => v1::Scorer::Raw.into(),
            Scorer::Classifier => v1::Scorer::Classifier.into(),
        },
        similarity: match similarity {
            Similarity::LastL2 => v1::Similarity::LastL2.into(),
            Similarity::LastCosine => v1::Similarity::LastCosine.into(),
            Similarity::SegmentL2 => v1::Similarity::SegmentL2.into(),
            Similarity::SegmentCosine => v1::Similarity::SegmentCosine.into(),
        },
        normaliser: match normaliser {
            NormaliserKind::MinMax => v1::Normaliser::Minmax.into(),
            NormaliserKind::Quantile => v1::Normaliser::Quantile.into(),
        },
        modality_scale: modality_scale.map(modality_scale_to_proto),
        seed,
        feature_scale: match feature_scale {
            FeatureScale::Whitened => v1::FeatureScale::Whitened.into(),
            FeatureScale::Plain => v1::FeatureScale::Plain.into(),
        },
        yardstick: match yardstick {
            Yardstick::Local => v1::Yardstick::Local.into(),
            Yardstick::None => v1::Yardstick::None.into(),
        },
        encoder_id: String::new(),
        snapshot_id: String::new(),
        extends: String::new(),
    }
}

/// Factors of the distances of o, m and a.
pub(crate) fn modality_scale_to_proto([image, proprioception, action]: [f64; 3]) -> v1::ModalityScale {
    v1::ModalityScale { image, proprioception, action }
}
