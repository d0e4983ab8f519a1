//! What the settings of every job share: how a run is carried out.

use serde::Serialize;

use super::within;
use crate::error::LearnError;

pub(super) fn validate_run(checkpoint_every: u32, threads: Option<u32>) -> Result<(), LearnError> {
    if checkpoint_every == 0 {
        return Err(LearnError::invalid("checkpoint_every", "must be at least 1"));
    }
    within("threads", f64::from(threads.unwrap_or(1)), 1.0, 1024.0)
}

/// The settings as JSON without those that only say how a run is carried out. The specs hold only
/// numbers, strings and lists, so they always have a JSON form.
pub(super) fn identity(spec: &impl Serialize) -> String {
    let mut json = serde_json::to_value(spec).unwrap_or_default();
    if let Some(fields) = json.as_object_mut() {
        for field in ["checkpoint_every", "device", "threads"] {
            fields.remove(field);
        }
    }
    json.to_string()
}
