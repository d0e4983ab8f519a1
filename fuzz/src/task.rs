//! A small task with mappings for all three dialects.

use std::io::Cursor;

use gleaner_recording::{
    CameraSource, CameraSpec, EpisodeWriter, FieldSource, FieldSpec, Mapping, StepRef, TaskSpec, frame_bytes_per_step,
    written_mapping,
};

/// Side of the task's images.
pub const SIDE: u32 = 8;

/// A camera with depth, three joints, a tool and a command.
pub fn task() -> TaskSpec {
    let mut spec: TaskSpec =
        serde_json::from_str(r#"{"name":"fuzz","rate_hz":10,"action":[{"name":"command","size":2}]}"#)
            .expect("the task is valid");
    spec.cameras = vec![CameraSpec { name: "front".into(), height: SIDE, width: SIDE, depth: true, recorded: None }];
    spec.proprioception = vec![FieldSpec::new("joints", 3), FieldSpec::new("tool", 2)];
    spec.mappings = vec![ros2(), json()];
    spec.mappings.push(written_mapping(&spec));
    gleaner_recording::validate(&spec).expect("the task is valid");
    spec
}

fn ros2() -> Mapping {
    let mut joints = source("joints", "/joint_states", &["position"]);
    joints.names = vec!["a".into(), "b".into(), "c".into()];
    mapping(
        "ros2",
        "/front",
        vec![
            joints,
            source("tool", "/tool_pose", &["pose.position.x", "pose.orientation.w"]),
            source("command", "/command", &["twist.linear.x", "twist.angular.z"]),
        ],
    )
}

fn json() -> Mapping {
    mapping(
        "json",
        "/json/front",
        vec![
            source("joints", "/json/joints", &["arm.position[0:2]", "arm.position[2]"]),
            source("tool", "/json/tool", &["parts.x"]),
            source("command", "/json/command", &["values"]),
        ],
    )
}

fn mapping(name: &str, camera: &str, fields: Vec<FieldSource>) -> Mapping {
    let camera = CameraSource {
        camera: "front".into(),
        color: format!("{camera}/color"),
        depth: Some(format!("{camera}/depth")),
    };
    Mapping { name: name.into(), cameras: vec![camera], fields, clock: None }
}

fn source(field: &str, topic: &str, paths: &[&str]) -> FieldSource {
    FieldSource {
        field: field.into(),
        topic: topic.into(),
        paths: paths.iter().map(|&path| path.into()).collect(),
        names: Vec::new(),
        transform: None,
    }
}

/// A recording of gleaner's own writer with this number of steps.
pub fn written(steps: u16) -> Vec<u8> {
    let spec = task();
    let mut writer = EpisodeWriter::create(Cursor::new(Vec::new()), &spec).expect("the task is valid");
    for step in 0..steps {
        let value = f32::from(step) / 10.0;
        let frames: Vec<u8> = (0..frame_bytes_per_step(&spec)).map(|at| (at as u8).wrapping_add(step as u8)).collect();
        let values = StepRef { frames: &frames, proprioception: &[value; 5], action: &[value; 2] };
        writer.step(1_000_000_000 + i64::from(step) * 100_000_000, values).expect("the step is valid");
    }
    writer.finish().expect("memory is writable").into_inner()
}
