//! Tasks on the wire: the spec in, the task with its counts out.

use gleaner_proto::v1;

use super::{field, page};
use crate::task_spec::default_static_topic;
use crate::{
    Alignment, Bound, CameraSource, CameraSpec, Crop, FieldSource, FieldSpec, Mapping, OpenpiKey, RecordedSize,
    TaskSpec, Transform,
    error::{Error, Result},
    id::TaskId,
    page::Page,
    task::{OutcomeCounts, Task},
};

/// Default tolerance, as a share of a period, when the message has none.
const TOLERANCE: f64 = 0.25;

/// The page of the tasks.
///
/// # Errors
/// Invalid names the field.
pub fn list_request(request: v1::ListTasksRequest) -> Result<Page<TaskId>> {
    let v1::ListTasksRequest { page_size, page_token } = request;
    page::page_by_id(page_size, &page_token)
}

/// A specification from its message. Its rules are checked where tasks are created.
///
/// # Errors
/// Invalid under `spec.alignment` for an alignment that this build does not have, and under a field with both forms of a
/// bound.
pub fn spec_from_proto(spec: v1::TaskSpec) -> Result<TaskSpec> {
    let v1::TaskSpec {
        name,
        rate_hz,
        cameras,
        proprioception,
        action,
        alignment,
        tolerance,
        mappings,
        instruction,
        openpi,
    } = spec;
    Ok(TaskSpec {
        name,
        instruction,
        rate_hz,
        cameras: cameras.into_iter().map(camera_from).collect(),
        proprioception: fields_from("spec.proprioception", proprioception)?,
        action: fields_from("spec.action", action)?,
        alignment: alignment_from(alignment)?,
        tolerance: tolerance.unwrap_or(TOLERANCE),
        mappings: mappings.into_iter().map(mapping_from).collect(),
        openpi: openpi.into_iter().map(|v1::OpenpiKey { name, key }| OpenpiKey { name, key }).collect(),
    })
}

fn camera_from(camera: v1::CameraSpec) -> CameraSpec {
    let v1::CameraSpec { name, height, width, depth, recorded } = camera;
    CameraSpec { name, height, width, depth, recorded: recorded.map(recorded_from) }
}

fn recorded_from(recorded: v1::RecordedSize) -> RecordedSize {
    let v1::RecordedSize { height, width, crop } = recorded;
    let crop = crop.map(|v1::Crop { top, left, height, width }| Crop { top, left, height, width });
    RecordedSize { height, width, crop }
}

fn fields_from(list: &str, fields: Vec<v1::FieldSpec>) -> Result<Vec<FieldSpec>> {
    let read = |(i, field): (usize, v1::FieldSpec)| {
        let v1::FieldSpec { name, size, unit, minimum, maximum, binary, minimum_each, maximum_each } = field;
        let minimum = bound_from(&format!("{list}[{i}].minimum"), minimum, minimum_each)?;
        let maximum = bound_from(&format!("{list}[{i}].maximum"), maximum, maximum_each)?;
        Ok(FieldSpec { name, size, unit, minimum, maximum, binary })
    };
    fields.into_iter().enumerate().map(read).collect()
}

fn bound_from(at: &str, all: Option<f32>, each: Vec<f32>) -> Result<Option<Bound>> {
    match (all, each.is_empty()) {
        (Some(_), false) => Err(Error::invalid(at, "give one number for all values or one for each, not both")),
        (all, true) => Ok(all.map(Bound::All)),
        (None, false) => Ok(Some(Bound::Each(each))),
    }
}

fn bound_to(bound: Option<Bound>) -> (Option<f32>, Vec<f32>) {
    match bound {
        Some(Bound::All(bound)) => (Some(bound), Vec::new()),
        Some(Bound::Each(bounds)) => (None, bounds),
        None => (None, Vec::new()),
    }
}

fn alignment_from(alignment: i32) -> Result<Alignment> {
    match v1::Alignment::try_from(alignment) {
        Ok(v1::Alignment::Unspecified | v1::Alignment::LatestBefore) => Ok(Alignment::LatestBefore),
        Ok(v1::Alignment::Nearest) => Ok(Alignment::Nearest),
        Err(_) => Err(Error::invalid("spec.alignment", "unknown value; supported: latest_before, nearest")),
    }
}

fn mapping_from(mapping: v1::Mapping) -> Mapping {
    let v1::Mapping { name, cameras, fields, clock } = mapping;
    let camera = |source| {
        let v1::CameraSource { camera, color, depth } = source;
        CameraSource { camera, color, depth: not_empty(depth) }
    };
    let field = |source| {
        let v1::FieldSource { field, topic, paths, names, transform } = source;
        let transform = transform.map(|transform| {
            let v1::Transform { parent, child, static_topic } = transform;
            Transform { parent, child, static_topic: static_topic.unwrap_or_else(default_static_topic) }
        });
        FieldSource { field, topic, paths, names, transform }
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
pub fn task(task: Task, counts: OutcomeCounts) -> v1::Task {
    let Task { id, spec, created_at } = task;
    let OutcomeCounts { success, failure, unknown } = counts;
    v1::Task {
        id: id.into(),
        spec: Some(spec_to_proto(spec)),
        create_time: Some(field::timestamp(created_at)),
        success_count: success,
        failure_count: failure,
        unknown_count: unknown,
    }
}

/// A specification as its message.
#[must_use]
pub fn spec_to_proto(spec: TaskSpec) -> v1::TaskSpec {
    let TaskSpec {
        name,
        instruction,
        rate_hz,
        cameras,
        proprioception,
        action,
        alignment,
        tolerance,
        mappings,
        openpi,
    } = spec;
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
        instruction,
        openpi: openpi.into_iter().map(|OpenpiKey { name, key }| v1::OpenpiKey { name, key }).collect(),
    }
}

fn camera_to(camera: CameraSpec) -> v1::CameraSpec {
    let CameraSpec { name, height, width, depth, recorded } = camera;
    v1::CameraSpec { name, height, width, depth, recorded: recorded.map(recorded_to) }
}

fn recorded_to(recorded: RecordedSize) -> v1::RecordedSize {
    let RecordedSize { height, width, crop } = recorded;
    let crop = crop.map(|Crop { top, left, height, width }| v1::Crop { top, left, height, width });
    v1::RecordedSize { height, width, crop }
}

fn field_to(field: FieldSpec) -> v1::FieldSpec {
    let FieldSpec { name, size, unit, minimum, maximum, binary } = field;
    let ((minimum, minimum_each), (maximum, maximum_each)) = (bound_to(minimum), bound_to(maximum));
    v1::FieldSpec { name, size, unit, minimum, maximum, binary, minimum_each, maximum_each }
}

fn mapping_to(mapping: Mapping) -> v1::Mapping {
    let Mapping { name, cameras, fields, clock } = mapping;
    let camera = |source| {
        let CameraSource { camera, color, depth } = source;
        v1::CameraSource { camera, color, depth: depth.unwrap_or_default() }
    };
    let field = |source| {
        let FieldSource { field, topic, paths, names, transform } = source;
        let transform = transform.map(|transform| {
            let Transform { parent, child, static_topic } = transform;
            v1::Transform { parent, child, static_topic: Some(static_topic) }
        });
        v1::FieldSource { field, topic, paths, names, transform }
    };
    v1::Mapping {
        name,
        cameras: cameras.into_iter().map(camera).collect(),
        fields: fields.into_iter().map(field).collect(),
        clock: clock.unwrap_or_default(),
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// A task with every part set.
    pub(crate) fn spec() -> TaskSpec {
        let source = |field: &str, names: &[&str]| FieldSource {
            field: field.into(),
            topic: "/state".into(),
            paths: vec!["position".into()],
            names: names.iter().map(|&name| name.into()).collect(),
            transform: None,
        };
        let transform = Transform { parent: "base".into(), child: "tool".into(), static_topic: "/fixed".into() };
        let tool = FieldSource { paths: Vec::new(), transform: Some(transform), ..source("tool", &[]) };
        TaskSpec {
            name: "reach".into(),
            instruction: "reach the cube".into(),
            openpi: vec![OpenpiKey { name: "hand".into(), key: "observation/wrist_image".into() }],
            rate_hz: 10.0,
            cameras: vec![CameraSpec {
                name: "front".into(),
                height: 4,
                width: 6,
                depth: true,
                recorded: Some(RecordedSize {
                    height: 8,
                    width: 16,
                    crop: Some(Crop { top: 1, left: 2, height: 6, width: 12 }),
                }),
            }],
            proprioception: vec![FieldSpec::new("joint_position", 2), FieldSpec::new("tool", Transform::SIZE)],
            action: vec![FieldSpec {
                minimum: Some(Bound::All(-1.0)),
                maximum: Some(Bound::All(1.0)),
                binary: true,
                ..FieldSpec::new("target", 1)
            }],
            alignment: Alignment::Nearest,
            tolerance: 0.1,
            mappings: vec![Mapping {
                name: "ros".into(),
                cameras: vec![CameraSource { camera: "front".into(), color: "/c".into(), depth: Some("/d".into()) }],
                fields: vec![source("joint_position", &["a", "b"]), tool, source("target", &[])],
                clock: Some("/state".into()),
            }],
        }
    }

    #[test]
    fn a_spec_survives_the_wire() {
        assert_eq!(spec_from_proto(spec_to_proto(spec())).unwrap(), spec());
        let mut listed = spec();
        (listed.action[0].size, listed.action[0].minimum) = (2, Some(Bound::Each(vec![-1.0, -0.5])));
        assert_eq!(spec_from_proto(spec_to_proto(listed.clone())).unwrap(), listed);
    }

    #[test]
    fn a_bound_in_both_forms_is_refused() {
        let mut sent = spec_to_proto(spec());
        sent.action[0].maximum_each = vec![1.0];
        let error = spec_from_proto(sent).unwrap_err().to_string();
        assert!(error.contains("spec.action[0].maximum") && error.contains("not both"), "{error}");
    }

    #[test]
    fn omitted_fields_have_their_defaults() {
        let mut sent = spec_to_proto(spec());
        (sent.tolerance, sent.alignment) = (None, 0);
        sent.mappings[0].fields[1].transform.as_mut().unwrap().static_topic = None;
        let spec = spec_from_proto(sent).unwrap();
        assert_eq!(spec.mappings[0].fields[1].transform.as_ref().unwrap().static_topic, "/tf_static");
        assert_eq!((spec.tolerance, spec.alignment), (0.25, Alignment::LatestBefore));
    }

    #[test]
    fn an_unknown_alignment_is_refused() {
        let error = spec_from_proto(v1::TaskSpec { alignment: 9, ..spec_to_proto(spec()) }).unwrap_err().to_string();
        assert!(error.starts_with("spec.alignment: "), "{error}");
    }
}
