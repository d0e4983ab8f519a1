//! A small task for the tests of this crate.

use gleaner_core::{Alignment, CameraSource, CameraSpec, FieldSource, FieldSpec, Mapping, TaskSpec};

/// A small task with one RGBD camera and JSON topics, for the tests of this crate.
pub(crate) fn arm() -> TaskSpec {
    let field = |field: &str, topic: &str, path: &str| FieldSource {
        field: field.into(),
        topic: topic.into(),
        paths: vec![path.into()],
        names: Vec::new(),
        transform: None,
    };
    TaskSpec {
        name: "arm".into(),
        instruction: String::new(),
        openpi: Vec::new(),
        rate_hz: 10.0,
        cameras: vec![CameraSpec { name: "front".into(), height: 8, width: 16, depth: true, recorded: None }],
        proprioception: vec![FieldSpec::new("joint_position", 2), FieldSpec::new("tool", 1)],
        action: vec![FieldSpec::new("command", 2)],
        alignment: Alignment::default(),
        tolerance: 0.25,
        mappings: vec![Mapping {
            name: "json".into(),
            cameras: vec![CameraSource {
                camera: "front".into(),
                color: "/front/color".into(),
                depth: Some("/front/depth".into()),
            }],
            fields: vec![
                field("joint_position", "/joints", "position"),
                field("tool", "/tool", "x"),
                field("command", "/command", "values"),
            ],
            clock: None,
        }],
    }
}
