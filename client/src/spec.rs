//! Conversion of a task's specification between its form in files and its form on the wire.
//!
//! Every message is taken apart field by field, so that a new field breaks the build rather than being lost.

use gleaner_proto::v1;
use gleaner_recording::{Alignment, CameraSource, CameraSpec, FieldSource, FieldSpec, Mapping, TaskSpec};

/// To the wire.
#[must_use]
pub fn to_proto(spec: &TaskSpec) -> v1::TaskSpec {
    let TaskSpec { name, rate_hz, cameras, proprioception, action, alignment, tolerance, mappings } = spec;
    v1::TaskSpec {
        name: name.clone(),
        rate_hz: *rate_hz,
        cameras: cameras.iter().map(camera_to_proto).collect(),
        proprioception: proprioception.iter().map(field_to_proto).collect(),
        action: action.iter().map(field_to_proto).collect(),
        alignment: match alignment {
            Alignment::LatestBefore => v1::Alignment::LatestBefore,
            Alignment::Nearest => v1::Alignment::Nearest,
        }
        .into(),
        tolerance: Some(*tolerance),
        mappings: mappings.iter().map(mapping_to_proto).collect(),
    }
}

fn camera_to_proto(camera: &CameraSpec) -> v1::CameraSpec {
    let CameraSpec { name, height, width, depth } = camera;
    v1::CameraSpec { name: name.clone(), height: *height, width: *width, depth: *depth }
}

fn field_to_proto(field: &FieldSpec) -> v1::FieldSpec {
    let FieldSpec { name, size } = field;
    v1::FieldSpec { name: name.clone(), size: *size }
}

fn mapping_to_proto(mapping: &Mapping) -> v1::Mapping {
    let Mapping { name, cameras, fields, clock } = mapping;
    let camera = |source: &CameraSource| {
        let CameraSource { camera, color, depth } = source;
        v1::CameraSource { camera: camera.clone(), color: color.clone(), depth: depth.clone().unwrap_or_default() }
    };
    let field = |source: &FieldSource| {
        let FieldSource { field, topic, paths, names } = source;
        v1::FieldSource { field: field.clone(), topic: topic.clone(), paths: paths.clone(), names: names.clone() }
    };
    v1::Mapping {
        name: name.clone(),
        cameras: cameras.iter().map(camera).collect(),
        fields: fields.iter().map(field).collect(),
        clock: clock.clone().unwrap_or_default(),
    }
}

/// From the wire. An alignment that this build does not know reads as the default.
#[must_use]
pub fn from_proto(spec: v1::TaskSpec) -> TaskSpec {
    let alignment = spec.alignment();
    let v1::TaskSpec { name, rate_hz, cameras, proprioception, action, alignment: _, tolerance, mappings } = spec;
    TaskSpec {
        name,
        rate_hz,
        cameras: cameras.into_iter().map(camera_from_proto).collect(),
        proprioception: proprioception.into_iter().map(field_from_proto).collect(),
        action: action.into_iter().map(field_from_proto).collect(),
        alignment: match alignment {
            v1::Alignment::Unspecified | v1::Alignment::LatestBefore => Alignment::LatestBefore,
            v1::Alignment::Nearest => Alignment::Nearest,
        },
        // The contract's default (task.proto).
        tolerance: tolerance.unwrap_or(0.25),
        mappings: mappings.into_iter().map(mapping_from_proto).collect(),
    }
}

fn camera_from_proto(camera: v1::CameraSpec) -> CameraSpec {
    let v1::CameraSpec { name, height, width, depth } = camera;
    CameraSpec { name, height, width, depth }
}

fn field_from_proto(field: v1::FieldSpec) -> FieldSpec {
    let v1::FieldSpec { name, size } = field;
    FieldSpec { name, size }
}

fn mapping_from_proto(mapping: v1::Mapping) -> Mapping {
    let v1::Mapping { name, cameras, fields, clock } = mapping;
    let camera = |source| {
        let v1::CameraSource { camera, color, depth } = source;
        CameraSource { camera, color, depth: unless_empty(depth) }
    };
    let field = |source| {
        let v1::FieldSource { field, topic, paths, names } = source;
        FieldSource { field, topic, paths, names }
    };
    Mapping {
        name,
        cameras: cameras.into_iter().map(camera).collect(),
        fields: fields.into_iter().map(field).collect(),
        clock: unless_empty(clock),
    }
}

fn unless_empty(text: String) -> Option<String> {
    (!text.is_empty()).then_some(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_spec_survives_the_wire() {
        let spec: TaskSpec = toml::from_str(
            r#"
            name = "pour"
            rate_hz = 12.5
            alignment = "nearest"
            tolerance = 0.4
            cameras = [{ name = "top", height = 48, width = 64, depth = true }, { name = "hand", height = 8, width = 9 }]
            proprioception = [{ name = "joints", size = 2 }]
            action = [{ name = "delta", size = 3 }]

            [[mappings]]
            name = "ros"
            clock = "/tick"
            cameras = [{ camera = "top", color = "/rgb", depth = "/d" }, { camera = "hand", color = "/hand" }]
            fields = [
              { field = "joints", topic = "/joint_states", paths = ["position"], names = ["a", "b"] },
              { field = "delta", topic = "/cmd", paths = ["linear.x", "linear.y", "gripper"] },
            ]
            "#,
        )
        .unwrap();
        let wire = to_proto(&spec);
        assert_eq!(wire.mappings[0].cameras[1].depth, "");
        assert_eq!(wire.tolerance, Some(0.4));
        assert_eq!(from_proto(wire), spec);
    }

    #[test]
    fn what_the_wire_leaves_out_takes_the_contracts_defaults() {
        let spec = from_proto(v1::TaskSpec::default());
        assert_eq!(spec.alignment, Alignment::LatestBefore);
        assert!((spec.tolerance - 0.25).abs() < f64::EPSILON);
    }
}
