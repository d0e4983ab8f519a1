//! The requests that create and update a task: its specification, checked.

use gleaner_proto::v1;
use gleaner_recording::{Limits, RecordingError, TaskSpec, validate_within};

use super::field;
use crate::error::{Error, Result};

pub(crate) use gleaner_core::proto::task::{list_request, task};

/// Reads and checks the specification of a task to be created.
///
/// # Errors
/// Invalid names the field, such as `spec.cameras[0].height`, and the remedy.
pub(crate) fn create_request(request: v1::CreateTaskRequest, limits: &Limits) -> Result<TaskSpec> {
    let v1::CreateTaskRequest { spec } = request;
    checked(spec, limits)
}

/// Reads and checks the new specification of a task: the name or id of the task, and the specification.
///
/// # Errors
/// As of [`create_request`].
pub(crate) fn update_request(request: v1::UpdateTaskRequest, limits: &Limits) -> Result<(String, TaskSpec)> {
    let v1::UpdateTaskRequest { task, spec } = request;
    Ok((task, checked(spec, limits)?))
}

fn checked(spec: Option<v1::TaskSpec>, limits: &Limits) -> Result<TaskSpec> {
    let spec = gleaner_core::proto::task::spec_from_proto(field::required("spec", spec)?)?;
    validate_within(&spec, limits).map_err(|error| {
        if let RecordingError::Spec { field, problem } = error {
            Error::invalid(&format!("spec.{field}"), problem)
        } else {
            Error::invalid("spec", error)
        }
    })?;
    if spec.mappings.is_empty() {
        return Err(Error::invalid("spec.mappings", "give at least one mapping: it locates the steps in a recording"));
    }
    Ok(spec)
}

#[cfg(test)]
mod tests {
    use gleaner_core::proto::task::spec_to_proto;

    use super::*;

    fn refusal(change: impl FnOnce(&mut v1::TaskSpec)) -> String {
        let mut spec = spec_to_proto(crate::store::testing::spec());
        change(&mut spec);
        create_request(v1::CreateTaskRequest { spec: Some(spec) }, &Limits::default()).unwrap_err().to_string()
    }

    #[test]
    fn a_wrong_field_is_named_by_its_path() {
        let missing = create_request(v1::CreateTaskRequest { spec: None }, &Limits::default()).unwrap_err();
        assert_eq!(missing.to_string(), "spec: must be set");
        assert!(refusal(|spec| spec.action[0].size = 0).starts_with("spec.action[0].size: "));
        assert!(refusal(|spec| spec.alignment = 9).starts_with("spec.alignment: "));
        assert!(refusal(|_| ()).starts_with("spec.mappings: "));
    }
}
