//! Tests of drafts, with surveys that each test describes.

use gleaner_recording::{Bound, FieldKind, SurveyedCamera, SurveyedField, SurveyedTopic, ValueRange};

use super::*;

mod orders;
mod repeats;
mod roles;
mod still;

fn range(minimum: f64, maximum: f64) -> ValueRange {
    ValueRange { minimum, maximum }
}

fn topic(name: &str, encoding: &str, fields: Vec<SurveyedField>) -> SurveyedTopic {
    SurveyedTopic {
        topic: name.into(),
        encoding: encoding.into(),
        messages: 100,
        rate_hz: 20.0,
        stamped: true,
        fields,
        ..SurveyedTopic::default()
    }
}

fn numbers(path: &str, ranges: &[ValueRange]) -> SurveyedField {
    let size = ranges.len() as u64;
    let kind = if size == 1 { FieldKind::Number } else { FieldKind::Numbers };
    SurveyedField {
        path: path.into(),
        kind,
        messages: 100,
        shortest: size,
        longest: size,
        ranges: ranges.to_vec(),
        ..SurveyedField::default()
    }
}

fn camera(name: &str, encoding: &str, (height, width): (u32, u32)) -> SurveyedTopic {
    let camera = SurveyedCamera { encoding: "jpeg".into(), height, width, ..SurveyedCamera::default() };
    SurveyedTopic { camera: Some(camera), ..topic(name, encoding, Vec::new()) }
}

fn recording(topics: Vec<SurveyedTopic>) -> Survey {
    Survey { messages: 100, topics, ..Survey::default() }
}

/// A lab's JSON recording: one camera, a state, an action in another message, and what no policy may see.
fn json() -> Survey {
    let gripper = SurveyedField { values: vec![0.0, 1.0], ..numbers("gripper", &[range(0.0, 1.0)]) };
    recording(vec![
        camera("/front/image", "json", (480, 640)),
        topic(
            "/obs",
            "json",
            vec![numbers("qpos", &[range(-1.0, 1.0), range(0.0, 2.0)]), numbers("frame_index", &[range(0.0, 99.0)])],
        ),
        topic("/cmd", "json", vec![numbers("delta", &[range(-0.95, 0.3), range(-0.2, 0.99)]), gripper]),
        topic("/result", "json", vec![numbers("success", &[range(0.0, 1.0)])]),
        topic(
            "/scan",
            "json",
            vec![SurveyedField { longest: 9, shortest: 3, ..numbers("ranges", &[range(0.0, 1.0)]) }],
        ),
    ])
}

fn known(name: &str) -> Known {
    Known { name: name.into(), action: Vec::new() }
}

fn written(draft: &Draft) -> TaskSpec {
    let spec = toml::from_str(&draft.to_string()).unwrap_or_else(|error| panic!("{error}\n{draft}"));
    gleaner_recording::validate(&spec).unwrap();
    spec
}

#[test]
fn a_draft_is_a_valid_task_with_its_reasons() {
    let survey = json();
    let draft = draft([&survey, &survey], &known("lab")).unwrap();
    let spec = written(&draft);
    assert_eq!(spec, draft.spec);
    assert_eq!((spec.name.as_str(), spec.rate_hz), ("lab", 20.0));
    let front = &spec.cameras[0];
    assert_eq!((front.name.as_str(), front.height, front.width), ("front", 96, 128));
    assert_eq!(front.sizes().recorded(), (480, 640));
    let names = |fields: &[gleaner_recording::FieldSpec]| -> Vec<String> {
        fields.iter().map(|field| format!("{} {}", field.name, field.size)).collect()
    };
    assert_eq!(names(&spec.proprioception), ["qpos 2"]);
    assert_eq!(names(&spec.action), ["delta 2", "gripper 1"]);
    assert_eq!(
        (spec.action[0].minimum.clone(), spec.action[0].maximum.clone(), spec.action[0].binary),
        (Some(Bound::All(-1.0)), Some(Bound::All(1.0)), false)
    );
    assert_eq!(
        (spec.action[1].minimum.clone(), spec.action[1].maximum.clone(), spec.action[1].binary),
        (Some(Bound::All(0.0)), Some(Bound::All(1.0)), true)
    );
    let text = draft.to_string();
    for part in [
        "from 2 recordings as `json`",
        "/front/image holds pictures of 480×640 pixels (jpeg)",
        "frame_index (json): it counts or is a time",
        "success (json): it is an outcome",
        "ranges (json): its length varies from 3 to 9",
    ] {
        assert!(text.contains(part), "{part}:\n{text}");
    }
}

#[test]
fn missing_cameras_are_a_doubt() {
    let survey = json();
    assert_eq!(draft([&survey, &survey], &known("lab")).unwrap().doubts(), Vec::<String>::new());
    let out = vec![numbers("target", &[range(-1.0, 1.0)]), numbers("grip", &[range(0.0, 1.0)])];
    let doubts = draft([&recording(vec![topic("/policy_out", "json", out)])], &known("lab")).unwrap().doubts();
    assert!(doubts.len() == 1 && doubts[0].starts_with("the task has no cameras"), "{doubts:?}");
}

#[test]
fn a_second_way_is_matched_by_names_and_ranges() {
    let joints = [range(-1.0, 1.0), range(0.0, 3.0), range(0.0, 0.04)];
    let pose = [
        range(0.1, 0.2),
        range(0.3, 0.5),
        range(0.0, 0.1),
        range(0.9, 1.0),
        range(-0.1, 0.0),
        range(0.0, 0.3),
        range(0.0, 0.1),
    ];
    let protobuf = recording(vec![
        topic("/robot/state", "protobuf", vec![numbers("joint_position", &joints), numbers("tool_pose", &pose)]),
        topic("/robot/action", "protobuf", vec![numbers("delta_pose", &[range(-1.0, 1.0), range(-0.5, 0.5)])]),
    ]);
    let by_name = SurveyedField {
        names: ["gripper1", "arm2", "arm1"].map(str::to_owned).into(),
        ranges: vec![joints[2], joints[1], joints[0]],
        ..numbers("position", &joints)
    };
    let parts =
        ["position.x", "position.y", "position.z", "orientation.x", "orientation.y", "orientation.z", "orientation.w"];
    let values = [pose[0], pose[1], pose[2], pose[4], pose[5], pose[6], pose[3]];
    let posed = parts.iter().zip(values).map(|(part, value)| numbers(&format!("pose.{part}"), &[value])).collect();
    let ros = recording(vec![
        topic("/joint_states", "cdr", vec![by_name]),
        topic("/tool_pose", "cdr", posed),
        topic("/servo/cmds", "cdr", vec![numbers("x", &[range(-1.0, 1.0)]), numbers("y", &[range(-0.5, 0.5)])]),
    ]);
    let draft = draft([&ros, &protobuf], &known("pick")).unwrap();
    let spec = written(&draft);
    let names: Vec<&str> = spec.mappings.iter().map(|mapping| mapping.name.as_str()).collect();
    assert_eq!(names, ["protobuf", "ros2"]);
    let ros = |field: &str| spec.mappings[1].fields.iter().find(|source| source.field == field).unwrap().clone();
    assert_eq!(ros("joint_position").names, ["arm1", "arm2", "gripper1"]);
    assert_eq!(ros("tool_pose").paths[3..5], ["pose.orientation.w", "pose.orientation.x"]);
    assert_eq!(ros("delta_pose").paths, ["x", "y"]);
    assert_eq!(spec.mappings[1].clock.as_deref(), Some("/servo/cmds"));
}

#[test]
fn numbers_that_are_alone_with_their_size_are_matched_with_a_warning() {
    let of = |encoding, state: &str, low| {
        let (state, command) = (format!("/{state}"), format!("/{state}/command"));
        recording(vec![
            topic(&state, encoding, vec![numbers("v", &[range(low, low + 1.0), range(0.0, 1.0)])]),
            topic(&command, encoding, vec![numbers("v", &[range(low, low + 1.0)])]),
        ])
    };
    let draft = draft([&of("json", "arm", 0.0), &of("protobuf", "robot", 100.0)], &known("t")).unwrap();
    assert_eq!((written(&draft).action.len(), draft.spec.proprioception.len()), (1, 1));
    assert!(draft.to_string().contains("its ranges do not fit, so compare their meaning"), "{draft}");
}

#[test]
fn joints_without_numbers_keep_the_order_of_the_recording() {
    let joints = SurveyedField {
        names: ["shoulder", "elbow"].map(str::to_owned).into(),
        ..numbers("position", &[range(0.0, 1.0), range(0.0, 2.0)])
    };
    let survey = recording(vec![
        topic("/joints", "json", vec![joints]),
        topic("/cmd", "json", vec![numbers("v", &[range(0.0, 5.0)])]),
    ]);
    let spec = draft([&survey], &known("t")).unwrap().spec;
    assert_eq!(spec.mappings[0].fields[0].names, ["shoulder", "elbow"]);
}

#[test]
fn commands_that_nothing_names_are_asked_for() {
    let survey = recording(vec![topic("/arm", "json", vec![numbers("v", &[range(0.0, 1.0)])])]);
    let problem = draft([&survey], &known("t")).unwrap_err();
    assert!(problem.contains("--action TOPIC") && problem.contains("/arm"), "{problem}");
    let named = Known { name: "t".into(), action: vec!["/arm".into()] };
    assert_eq!(draft([&survey], &named).unwrap().spec.action[0].name, "v");
    let wrong = Known { name: "t".into(), action: vec!["/leg".into()] };
    assert!(draft([&survey], &wrong).unwrap_err().contains("--action /leg"));
}

#[test]
fn steps_follow_a_camera_slower_than_the_commands() {
    let mut survey = json();
    for topic in &mut survey.topics {
        topic.rate_hz = if topic.camera.is_some() { 29.7 } else { 100.0 };
    }
    let draft = draft([&survey], &known("t")).unwrap();
    let spec = written(&draft);
    assert_eq!(spec.rate_hz, 30.0);
    assert_eq!(spec.mappings[0].clock.as_deref(), Some(spec.mappings[0].cameras[0].color.as_str()));
    let reason = draft.to_string().replace("\n# ", " ");
    for part in ["Commands come at 100.0 Hz and the slowest camera at 29.7 Hz", "take 100.0 here and /cmd as `clock`"] {
        assert!(reason.contains(part), "{part}: {reason}");
    }
}

#[test]
fn steps_follow_commands_that_are_little_faster_than_a_camera() {
    let mut survey = json();
    for topic in &mut survey.topics {
        topic.rate_hz = if topic.camera.is_some() { 11.8 } else { 20.0 };
    }
    let draft = draft([&survey], &known("t")).unwrap();
    let spec = written(&draft);
    assert_eq!((spec.rate_hz, spec.mappings[0].clock.as_deref()), (20.0, Some("/cmd")));
    let reason = draft.to_string().replace("\n# ", " ");
    assert!(reason.contains("commands less often, take 12.0 here and /front/image as `clock`"), "{reason}");
}

#[test]
fn hostile_names_stay_in_their_comments_and_strings() {
    let hostile = "/x\"\n[evil]\u{1b}";
    let survey = recording(vec![
        topic(hostile, "json", vec![numbers("a", &[range(0.0, 4.0)])]),
        topic("/cmd", "json", vec![numbers("v", &[range(0.0, 5.0)])]),
    ]);
    let draft = draft([&survey], &known("t")).unwrap();
    let spec: TaskSpec = toml::from_str(&draft.to_string()).unwrap();
    assert_eq!(spec.mappings[0].fields[0].topic, hostile);
    assert!(!draft.to_string().contains("\u{1b}"), "{draft}");
}

#[test]
fn transforms_of_frames_are_left_out_with_the_way_to_take_one() {
    let transforms = SurveyedTopic { schema: "tf2_msgs/msg/TFMessage".into(), ..topic("/tf", "cdr", Vec::new()) };
    let mut survey = Survey { topics: vec![transforms], ..Survey::default() };
    let joints = topic("/joints", "cdr", vec![numbers("position", &[ValueRange::of(0.5); 2])]);
    survey.topics.push(SurveyedTopic { schema: "sensor_msgs/msg/JointState".into(), ..joints });
    survey.topics.push(topic("/action", "cdr", vec![numbers("data", &[ValueRange::of(0.25); 2])]));
    let draft = draft([&survey], &Known::default()).unwrap();
    assert!(draft.to_string().contains("Its unit is by the conventions of ROS."), "{draft}");
    assert!(draft.to_string().contains("size = 2\nunit = \"rad or m\"\n"), "{draft}");
    let spec: TaskSpec = toml::from_str(&draft.to_string()).unwrap();
    assert_eq!(spec.proprioception[0].unit, draft.spec.proprioception[0].unit);
    let left: Vec<String> = draft.left_out.iter().map(|left| format!("{}: {}", left.what, left.reason)).collect();
    assert_eq!(left.len(), 1, "{left:?}");
    assert!(left[0].starts_with("/tf (ros2): it has the poses of frames: a field of size 7"), "{left:?}");
}
