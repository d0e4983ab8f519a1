//! Scoring on the wire.

use crate::ScoreSpec;
use gleaner_proto::v1;

use super::settings::{self, optional_snapshot};
use crate::{
    error::{Error, Result},
    id::{EncoderId, ScoreRunId},
    order::JobOrder,
};

pub(super) fn order(at: &str, spec: v1::ScoreSpec) -> Result<JobOrder> {
    let v1::ScoreSpec { encoder_id, snapshot_id, extends, settings } = spec;
    let extends = match extends.as_str() {
        "" => None,
        id => Some(ScoreRunId::parse(&format!("{at}.extends"), id)?),
    };
    let encoder_id = match encoder_id.as_str() {
        "" => None,
        id => Some(EncoderId::parse(&format!("{at}.encoder_id"), id)?),
    };
    let snapshot_id = optional_snapshot(at, &snapshot_id)?;
    let spec = settings::from_proto(at, settings, ScoreSpec::from_values)?;
    Ok(JobOrder::Score { encoder_id, snapshot_id, extends, spec })
}

/// The scoring of a pipeline, which chooses the encoder and the snapshot itself.
pub(super) fn of_pipeline(at: &str, spec: v1::ScoreSpec) -> Result<ScoreSpec> {
    let v1::ScoreSpec { encoder_id, snapshot_id, extends, settings } = spec;
    for (name, id) in [("encoder_id", encoder_id), ("snapshot_id", snapshot_id), ("extends", extends)] {
        if !id.is_empty() {
            return Err(Error::invalid(
                &format!("{at}.{name}"),
                "must be left out: the pipeline scores its own encoder's snapshot",
            ));
        }
    }
    settings::from_proto(at, settings, ScoreSpec::from_values)
}

/// The settings, without the ids of encoder, snapshot and base run.
pub(super) fn to_proto(spec: &ScoreSpec) -> v1::ScoreSpec {
    v1::ScoreSpec { settings: settings::to_proto(&spec.values()), ..v1::ScoreSpec::default() }
}
