//! Pretraining on the wire.

use gleaner_learn::{ModelSpec, Objective, PretrainSpec};
use gleaner_proto::v1;

use super::settings::{
    augmentation_from, augmentation_to, device_from, device_to, optim_from, optim_to, optional_snapshot, preset_from,
    preset_to, refused,
};
use crate::{
    domain::{id::SnapshotId, snapshot::RoleRule},
    error::{Error, Result},
    wire::snapshot,
};

/// Every objective, in the order in which a spec names them.
const OBJECTIVES: [(v1::Objective, Objective); 3] =
    [(v1::Objective::Mtp, Objective::Mtp), (v1::Objective::Tr, Objective::Tr), (v1::Objective::Aa, Objective::Aa)];

pub(super) fn from_proto(at: &str, spec: v1::PretrainSpec) -> Result<(Option<SnapshotId>, RoleRule, PretrainSpec)> {
    let v1::PretrainSpec {
        snapshot_id,
        rule,
        preset,
        segment_length,
        optim,
        seed,
        device,
        checkpoint_every,
        objectives,
        augmentation,
    } = spec;
    let default = PretrainSpec::default();
    let spec = PretrainSpec {
        model: ModelSpec {
            preset: preset_from(at, preset)?,
            segment_length: segment_length.unwrap_or(default.model.segment_length),
        },
        objectives: objectives_from(&format!("{at}.objectives"), &objectives)?,
        augmentation: augmentation_from(augmentation),
        optim: optim_from(optim),
        seed,
        device: device_from(at, device)?,
        checkpoint_every: checkpoint_every.unwrap_or(default.checkpoint_every),
        ..default
    };
    spec.validate().map_err(|error| refused(at, error))?;
    let rule = snapshot::rule_from_proto(&format!("{at}.rule"), rule)?;
    Ok((optional_snapshot(at, &snapshot_id)?, rule, spec))
}

/// None means all. The order in which a caller names them means nothing, so it is always ours.
fn objectives_from(at: &str, named: &[i32]) -> Result<Vec<Objective>> {
    for (place, objective) in named.iter().enumerate() {
        let known = OBJECTIVES.iter().any(|(word, _)| i32::from(*word) == *objective);
        if !known {
            return Err(Error::invalid(&format!("{at}[{place}]"), "is none that this server knows; use MTP, TR or AA"));
        }
        if named[..place].contains(objective) {
            return Err(Error::invalid(&format!("{at}[{place}]"), "comes twice; name each objective once"));
        }
    }
    let chosen = OBJECTIVES.iter().filter(|(word, _)| named.is_empty() || named.contains(&i32::from(*word)));
    Ok(chosen.map(|(_, objective)| *objective).collect())
}

pub(super) fn to_proto(spec: PretrainSpec, snapshot_id: String, rule: Option<RoleRule>) -> v1::PretrainSpec {
    let PretrainSpec { model, objectives, augmentation, optim, seed, checkpoint_every, device, threads: _ } = spec;
    let words = OBJECTIVES.iter().filter(|(_, objective)| objectives.contains(objective));
    v1::PretrainSpec {
        snapshot_id,
        rule: rule.map(snapshot::rule_to_proto),
        preset: preset_to(model.preset),
        segment_length: Some(model.segment_length),
        optim: Some(optim_to(optim)),
        seed,
        device: device_to(device),
        checkpoint_every: Some(checkpoint_every),
        objectives: words.map(|(word, _)| i32::from(*word)).collect(),
        augmentation: Some(augmentation_to(augmentation)),
    }
}
