//! Pretraining on the wire.

use crate::PretrainSpec;
use gleaner_proto::v1;

use super::settings::{self, optional_snapshot};
use crate::{
    error::Result,
    proto::snapshot,
    {id::SnapshotId, snapshot::RoleRule},
};

pub(super) fn from_proto(at: &str, spec: v1::PretrainSpec) -> Result<(Option<SnapshotId>, RoleRule, PretrainSpec)> {
    let v1::PretrainSpec { snapshot_id, rule, settings } = spec;
    let spec = settings::from_proto(at, settings, PretrainSpec::from_values)?;
    let rule = snapshot::rule_from_proto(&format!("{at}.rule"), rule)?;
    Ok((optional_snapshot(at, &snapshot_id)?, rule, spec))
}

pub(super) fn to_proto(spec: &PretrainSpec, snapshot_id: String, rule: Option<RoleRule>) -> v1::PretrainSpec {
    let rule = rule.map(snapshot::rule_to_proto);
    v1::PretrainSpec { snapshot_id, rule, settings: settings::to_proto(&spec.values()) }
}
