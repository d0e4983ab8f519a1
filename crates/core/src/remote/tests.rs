//! Records of policies on other servers: their defaults, and every wrong field by its name.

use super::*;
use crate::{error::Kind, task_spec::FieldSpec};

fn task() -> TaskSpec {
    let mut task: TaskSpec =
        serde_json::from_str(r#"{"name":"t","rate_hz":5,"action":[{"name":"a","size":3}],"mappings":[]}"#).unwrap();
    let camera = |name: &str, depth| CameraSpec { name: name.into(), height: 8, width: 8, depth, recorded: None };
    task.cameras = vec![camera("top", true), camera("wrist", false)];
    task.proprioception = vec![FieldSpec::new("joints", 2), FieldSpec::new("gripper", 1)];
    task
}

fn record(protocol: Protocol) -> RemotePolicy {
    RemotePolicy {
        protocol,
        address: "http://gpu:8001".into(),
        model: if protocol == Protocol::OpenInference { "arm@prod".into() } else { String::new() },
        model_version: String::new(),
        inputs: Vec::new(),
        output: String::new(),
        chunk_length: 0,
        execute_length: 0,
        sequences: false,
        answer_within_ms: 0,
        source: "lab".into(),
    }
}

#[test]
fn a_record_without_names_has_those_of_gleaners_own_servers() {
    let names = |protocol| {
        let policy = record(protocol).checked(&task()).unwrap();
        let names: Vec<String> = policy.inputs.into_iter().map(|input| input.name).collect();
        (names.join(" "), policy.output, policy.chunk_length, policy.answer_within_ms)
    };
    let open = "top top.depth wrist proprioception executed_action".to_owned();
    assert_eq!(names(Protocol::OpenInference), (open, "action".to_owned(), 1, DEFAULT_WITHIN_MS));
    let openpi = "observation/top observation/top_depth observation/wrist observation/state".to_owned();
    assert_eq!(names(Protocol::Openpi), (openpi, "actions".to_owned(), 1, DEFAULT_WITHIN_MS));
}

#[test]
fn a_record_survives_its_row() {
    let policy = record(Protocol::Openpi).checked(&task()).unwrap();
    let json = serde_json::to_string(&policy).unwrap();
    assert!(json.contains(r#""protocol":"openpi""#), "{json}");
    assert_eq!(serde_json::from_str::<RemotePolicy>(&json).unwrap(), policy);
    assert_eq!(policy.clone().checked(&task()).unwrap(), policy, "defaults are filled in once");
}

#[test]
fn every_wrong_field_is_named() {
    type Spoil = fn(&mut RemotePolicy);
    let input = |value: InputValue| RemoteInput { name: "x".into(), value };
    let cases: [(&str, Spoil); 15] = [
        ("remote.address: ", |p| p.address = "http://a b".into()),
        ("remote.address: ", |p| p.address = "x".repeat(513)),
        ("remote.model: ", |p| p.model.clear()),
        ("remote.model: ", |p| p.model = "a\u{7}".into()),
        ("remote.model_version: ", |p| p.model_version = "x".repeat(256)),
        ("remote.model_version: ", |p| {
            (p.protocol, p.model, p.model_version) = (Protocol::Openpi, String::new(), "1".into())
        }),
        ("remote.model: ", |p| p.protocol = Protocol::Openpi),
        ("remote.sequences: ", |p| (p.protocol, p.model, p.sequences) = (Protocol::Openpi, String::new(), true)),
        ("remote.output: ", |p| p.output = "\n".into()),
        ("remote.chunk_length: ", |p| p.chunk_length = 1025),
        ("remote.execute_length: ", |p| p.execute_length = 2),
        ("remote.answer_within_ms: ", |p| p.answer_within_ms = 60_001),
        ("remote.source: ", |p| p.source = "x".repeat(256)),
        ("remote.inputs: ", |p| {
            p.inputs =
                (0..65).map(|at| RemoteInput { name: at.to_string(), value: InputValue::Proprioception }).collect();
        }),
        ("remote.inputs[1].name: ", |p| {
            p.inputs = vec![RemoteInput { name: "x".into(), value: InputValue::Proprioception }; 2];
        }),
    ];
    for (field, spoil) in cases {
        let mut policy = record(Protocol::OpenInference);
        spoil(&mut policy);
        let error = policy.checked(&task()).unwrap_err();
        assert_eq!(error.kind(), Kind::Invalid);
        assert!(error.message().starts_with(field), "{field} expected: {error}");
    }
    for (field, value) in [
        (
            "remote.inputs[0].camera: the task has no camera \"left\"; it has top, wrist",
            InputValue::Camera("left".into()),
        ),
        ("remote.inputs[0].camera_planes: ", InputValue::CameraPlanes("left".into())),
        ("remote.inputs[0].depth: camera wrist has no depth", InputValue::Depth("wrist".into())),
        ("remote.inputs[0].field: ", InputValue::Field("a".into())),
        ("remote.inputs[0].text: ", InputValue::Text("x".repeat(1001))),
    ] {
        let error = RemotePolicy { inputs: vec![input(value)], ..record(Protocol::OpenInference) }.checked(&task());
        let error = error.unwrap_err();
        assert!(error.message().starts_with(field), "{field} expected: {error}");
    }
}
