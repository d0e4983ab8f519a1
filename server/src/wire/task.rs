//! Tasks on the wire: the spec in, the task with its counts out.

use gleaner_proto::v1;
use gleaner_recording::{
    Alignment, CameraSource, CameraSpec, FieldSource, FieldSpec, Limits, Mapping, RecordingError, TaskSpec,
};

use super::field;
use crate::{
    domain::task::{OutcomeCounts, Task},
    error::{Error, Result},
};

/// What a message that a step may follow by is worth when the client says nothing, as a share of a period.
const TOLERANCE: f64 = 0.25;

/// Reads and checks the spec of a task to be created.
///
/// # Errors
/// Invalid names the field, such as `spec.cameras[0].height`, and the mend.
pub(crate) fn create_request(request: v1::CreateTaskRequest, limits: &Limits) -> Result<TaskSpec> {
    let v1::CreateTaskRequest { spec } = request;
    let spec = spec_from(field::required("spec", spec)?)?;
    spec.validate_within(limits).map_err(|error| {
        if let RecordingError::Spec { field, problem } = error {
            Error::invalid(&format!("spec.{field}"), problem)
        } else {
            Error::invalid("spec", error)
        }
    })?;
    if spec.mappings.is_empty() {
        return Err(Error::invalid(
            "spec.mappings",
            "give at least one mapping: it says where recordings keep the steps",
        ));
    }
    Ok(spec)
}

fn spec_from(spec: v1::TaskSpec) -> Result<TaskSpec> {
    let v1::TaskSpec { name, rate_hz, cameras, proprioception, action, alignment, tolerance, mappings } = spec;
    Ok(TaskSpec {
        name,
        rate_hz,
        cameras: cameras.into_iter().map(camera_from).collect(),
        proprioception: proprioception.into_iter().map(field_from).collect(),
        action: action.into_iter().map(field_from).collect(),
        alignment: alignment_from(alignment)?,
        tolerance: tolerance.unwrap_or(TOLERANCE),
        mappings: mappings.into_iter().map(mapping_from).collect(),
    })
}

fn camera_from(camera: v1::CameraSpec) -> CameraSpec {
    let v1::CameraSpec { name, height, width, depth } = camera;
    CameraSpec { name, height, width, depth }
}

fn field_from(field: v1::FieldSpec) -> FieldSpec {
    let v1::FieldSpec { name, size } = field;
    FieldSpec { name, size }
}

fn alignment_from(alignment: i32) -> Result<Alignment> {
    match v1::Alignment::try_from(alignment) {
        Ok(v1::Alignment::Unspecified | v1::Alignment::LatestBefore) => Ok(Alignment::LatestBefore),
        Ok(v1::Alignment::Nearest) => Ok(Alignment::Nearest),
        Err(_) => Err(Error::invalid("spec.alignment", "is none that this server knows")),
    }
}

fn mapping_from(mapping: v1::Mapping) -> Mapping {
    let v1::Mapping { name, cameras, fields, clock } = mapping;
    let camera = |source| {
        let v1::CameraSource { camera, color, depth } = source;
        CameraSource { camera, color, depth: not_empty(depth) }
    };
    let field = |source| {
        let v1::FieldSource { field, topic, paths, names } = source;
        FieldSource { field, topic, paths, names }
    };
    Mapping {
        name,
        cameras: cameras.into_iter().map(camera).collect(),
        fields: fields.into_iter().map(field).collect(),
        clock: not_empty(clock),
    }
}

fn not_empty(text: String) -> Option<String> {
    (!text.is_empty()).then_some(text)
}

/// A task with its episodes counted.
pub(crate) fn task(task: Task, counts: OutcomeCounts) -> v1::Task {
    let Task { id, spec, created_at } = task;
    let OutcomeCounts { success, failure, unknown } = counts;
    v1::Task {
        id: id.into(),
        spec: Some(spec_to(spec)),
        create_time: Some(field::timestamp(created_at)),
        success_count: success,
        failure_count: failure,
        unknown_count: unknown,
    }
}

/// A spec.
pub(crate) fn spec_to(spec: TaskSpec) -> v1::TaskSpec {
    let TaskSpec { name, rate_hz, cameras, proprioception, action, alignment, tolerance, mappings } = spec;
    let alignment = match alignment {
        Alignment::LatestBefore => v1::Alignment::LatestBefore,
        Alignment::Nearest => v1::Alignment::Nearest,
    };
    v1::TaskSpec {
        name,
        rate_hz,
        cameras: cameras.into_iter().map(camera_to).collect(),
        proprioception: proprioception.into_iter().map(field_to).collect(),
        action: action.into_iter().map(field_to).collect(),
        alignment: alignment.into(),
        tolerance: Some(tolerance),
        mappings: mappings.into_iter().map(mapping_to).collect(),
    }
}

fn camera_to(camera: CameraSpec) -> v1::CameraSpec {
    let CameraSpec { name, height, width, depth } = camera;
    v1::CameraSpec { name, height, width, depth }
}

fn field_to(field: FieldSpec) -> v1::FieldSpec {
    let FieldSpec { name, size } = field;
    v1::FieldSpec { name, size }
}

fn mapping_to(mapping: Mapping) -> v1::Mapping {
    let Mapping { name, cameras, fields, clock } = mapping;
    let camera = |source| {
        let CameraSource { camera, color, depth } = source;
        v1::CameraSource { camera, color, depth: depth.unwrap_or_default() }
    };
    let field = |source| {
        let FieldSource { field, topic, paths, names } = source;
        v1::FieldSource { field, topic, paths, names }
    };
    v1::Mapping {
        name,
        cameras: cameras.into_iter().map(camera).collect(),
        fields: fields.into_iter().map(field).collect(),
        clock: clock.unwrap_or_default(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spec() -> TaskSpec {
        let source = |field: &str, names: &[&str]| FieldSource {
            field: field.into(),
            topic: "/state".into(),
            paths: vec!["position".into()],
            names: names.iter().map(|&name| name.into()).collect(),
        };
        TaskSpec {
            name: "reach".into(),
            rate_hz: 10.0,
            cameras: vec![CameraSpec { name: "front".into(), height: 4, width: 6, depth: true }],
            proprioception: vec![FieldSpec { name: "joint_position".into(), size: 2 }],
            action: vec![FieldSpec { name: "target".into(), size: 1 }],
            alignment: Alignment::Nearest,
            tolerance: 0.1,
            mappings: vec![Mapping {
                name: "ros".into(),
                cameras: vec![CameraSource { camera: "front".into(), color: "/c".into(), depth: Some("/d".into()) }],
                fields: vec![source("joint_position", &["a", "b"]), source("target", &[])],
                clock: Some("/state".into()),
            }],
        }
    }

    fn refusal(change: impl FnOnce(&mut v1::TaskSpec)) -> String {
        let mut spec = spec_to(spec());
        change(&mut spec);
        create_request(v1::CreateTaskRequest { spec: Some(spec) }, &Limits::default()).unwrap_err().to_string()
    }

    #[test]
    fn a_spec_survives_the_wire() {
        let request = v1::CreateTaskRequest { spec: Some(spec_to(spec())) };
        assert_eq!(create_request(request, &Limits::default()).unwrap(), spec());
    }

    #[test]
    fn what_is_left_out_gets_its_default() {
        let mut sent = spec_to(spec());
        (sent.tolerance, sent.alignment) = (None, 0);
        let spec = create_request(v1::CreateTaskRequest { spec: Some(sent) }, &Limits::default()).unwrap();
        assert_eq!((spec.tolerance, spec.alignment), (0.25, Alignment::LatestBefore));
    }

    #[test]
    fn a_wrong_field_is_named_by_its_path() {
        let missing = create_request(v1::CreateTaskRequest { spec: None }, &Limits::default()).unwrap_err();
        assert_eq!(missing.to_string(), "spec: must be set");
        assert!(refusal(|spec| spec.cameras[0].height = 0).starts_with("spec.cameras[0].height: "));
        assert!(refusal(|spec| spec.alignment = 9).starts_with("spec.alignment: "));
        assert!(refusal(|spec| spec.mappings.clear()).starts_with("spec.mappings: "));
    }
}
