//! Settings of jobs on the wire, where they are data, and the errors of reading them.

use crate::{Problem, Values, proto};
use prost_types::Struct;

use crate::{
    error::{Error, Result},
    id::SnapshotId,
};

/// Reads the settings of a spec: `read` checks them against the schema.
pub(super) fn from_proto<S>(
    at: &str,
    settings: Option<Struct>,
    read: impl FnOnce(&Values) -> std::result::Result<S, Problem>,
) -> Result<S> {
    read(&proto::from_struct(settings))
        .map_err(|Problem { field, message }| Error::invalid(&format!("{at}.settings.{field}"), message))
}

/// Settings for the wire.
pub(super) fn to_proto(values: &Values) -> Option<Struct> {
    Some(proto::to_struct(values))
}

pub(super) fn optional_snapshot(at: &str, id: &str) -> Result<Option<SnapshotId>> {
    if id.is_empty() { Ok(None) } else { SnapshotId::parse(&format!("{at}.snapshot_id"), id).map(Some) }
}
