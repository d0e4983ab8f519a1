//! What a draft leaves out of the observations, and what it has as comments.

use gleaner_recording::FieldSpec;

use super::*;

fn names(fields: &[FieldSpec]) -> Vec<&str> {
    fields.iter().map(|field| field.name.as_str()).collect()
}

/// The draft with its commented-out lines in use, as a reader changes it.
fn in_use(draft: &Draft) -> TaskSpec {
    let line = |line: &str| match line.strip_prefix('#') {
        Some(rest) if !rest.starts_with(' ') || rest.starts_with("  ") => rest.to_owned(),
        Some(_) | None => line.to_owned(),
    };
    let text: Vec<String> = draft.to_string().lines().map(line).collect();
    let spec = toml::from_str(&text.join("\n")).unwrap_or_else(|error| panic!("{error}\n{draft}"));
    gleaner_recording::validate(&spec).unwrap();
    spec
}

/// A `JointState` with positions, velocities and efforts of these joints, and a twist as the command.
fn arm(joints: &[&str]) -> Survey {
    let of = |path: &str, high: f64| SurveyedField {
        names: joints.iter().map(|&name| name.to_owned()).collect(),
        ..numbers(path, &vec![range(-high, high); joints.len()])
    };
    let state = topic("/joint_states", "cdr", vec![of("position", 3.0), of("velocity", 2.5), of("effort", 40.0)]);
    let state = SurveyedTopic { schema: "sensor_msgs/msg/JointState".into(), ..state };
    let command = topic("/cmd", "cdr", vec![numbers("linear.x", &[range(-0.3, 0.4)])]);
    recording(vec![camera("/front", "cdr", (96, 96)), state, command])
}

#[test]
fn velocities_and_efforts_of_joints_with_positions_are_comments_that_can_be_used() {
    // Also with a list of names that takes several lines.
    let many: Vec<String> = (1..=7).map(|joint| format!("a_robot_with_long_names_of_its_joints_{joint}")).collect();
    let many: Vec<&str> = many.iter().map(String::as_str).collect();
    for joints in [&["arm1", "arm2"][..], &many] {
        let draft = draft([&arm(joints)], &known("t")).unwrap();
        let spec = written(&draft);
        assert_eq!(names(&spec.proprioception), ["joint_position"]);
        assert_eq!((&spec, spec.mappings[0].fields.len()), (&draft.spec, 2));
        let text = draft.to_string();
        for part in [
            "Commented out beside joint_position: velocities and torques follow the last command",
            "#[[proprioception]]\n#name = \"joint_velocity\"\n",
            "#[[proprioception]]\n#name = \"joint_effort\"\n",
            "\n\n#[[mappings.fields]]\n#field = \"joint_effort\"\n#topic = \"/joint_states\"\n",
        ] {
            assert!(text.contains(part), "{part}: {text}");
        }
        assert_eq!(text.matches("Commented out beside").count(), 1, "{text}");
        let all = in_use(&draft);
        assert_eq!(names(&all.proprioception), ["joint_position", "joint_velocity", "joint_effort"]);
        assert_eq!(all.mappings[0].fields.len(), 4);
        assert_eq!(draft.doubts(), Vec::<String>::new());
    }
}

#[test]
fn velocities_and_efforts_without_the_positions_of_their_joints_are_observations() {
    let mut survey = arm(&["arm1", "arm2"]);
    survey.topics[1].fields.remove(0);
    let draft_of_rates = draft([&survey], &known("t")).unwrap();
    assert_eq!(names(&written(&draft_of_rates).proprioception), ["joint_velocity", "joint_effort"]);
    for shared in ["Its unit is by the conventions of ROS.", "To leave out a joint, delete"] {
        assert_eq!(draft_of_rates.to_string().matches(shared).count(), 1, "at the first field alone: {draft_of_rates}");
    }
    // Positions of other joints.
    let state = |part: &str, path: &str, joint: &str| SurveyedField {
        names: vec![joint.to_owned()],
        ..numbers(&format!("{part}.{path}"), &[range(-1.5, 2.5)])
    };
    survey.topics[1].fields = vec![state("arm", "position", "elbow"), state("lift", "effort", "lift")];
    let spec = written(&draft([&survey], &known("t")).unwrap());
    assert_eq!(names(&spec.proprioception), ["joint_position", "joint_effort"]);
}

#[test]
fn positions_and_torques_in_arrays_of_one_size_are_of_the_same_joints() {
    let of = |qpos: usize, torque: usize| {
        let state =
            vec![numbers("qpos", &vec![range(-1.0, 2.0); qpos]), numbers("torque", &vec![range(-3.0, 3.0); torque])];
        let command = topic("/cmd", "json", vec![numbers("delta", &[range(-0.3, 0.4)])]);
        let draft = draft([&recording(vec![topic("/obs", "json", state), command])], &known("t")).unwrap();
        names(&written(&draft).proprioception).join(" ")
    };
    assert_eq!((of(6, 6), of(7, 6)), ("qpos".to_owned(), "qpos torque".to_owned()));
}

#[test]
fn commands_that_are_not_the_action_are_left_out_with_the_reason() {
    let survey = recording(vec![
        topic("/joints", "json", vec![numbers("q", &[range(-1.0, 1.0), range(0.0, 2.0)])]),
        topic("/cmd", "json", vec![numbers("v", &[range(-0.3, 0.4)])]),
        topic("/target_pose", "json", vec![numbers("v", &[range(0.1, 0.9), range(0.2, 0.3)])]),
    ]);
    let draft = draft([&survey], &known("t")).unwrap();
    assert_eq!(names(&written(&draft).proprioception), ["q"]);
    assert_eq!(names(&draft.spec.action), ["v"], "the name of what is left out is free");
    let text = draft.to_string().replace("\n# ", " ");
    assert!(text.contains("- /target_pose v (json): it is named like a command and no part of the action"), "{text}");
    assert!(text.contains("add --action /target_pose if the robot executes it"), "{text}");
    let named = Known { name: "t".into(), action: vec!["/target_pose".into(), "/cmd".into()] };
    assert_eq!(super::draft([&survey], &named).unwrap().spec.action.len(), 2);
}

#[test]
fn the_copy_of_an_action_is_left_out() {
    let with = |name: &str, path: &str, ranges: &[ValueRange]| {
        let survey = recording(vec![
            topic("/joints", "json", vec![numbers("q", &[range(-1.0, 1.0), range(0.0, 2.0)])]),
            topic("/cmd", "json", vec![numbers("v", &[range(-0.3, 0.4)]), numbers("gripper", &[range(0.0, 1.0)])]),
            topic(name, "json", vec![numbers(path, ranges)]),
        ]);
        let draft = draft([&survey], &known("t")).unwrap();
        let left = draft.left_out.iter().any(|left| left.reason.contains("repeats the action"));
        assert_eq!(left, written(&draft).proprioception.len() == 1, "{draft}");
        left
    };
    for (topic, path, ranges) in [
        ("/executed", "x", [range(-0.3, 0.400_000_01)]),
        ("/hand", "gripper", [range(0.0, 1.0)]),
        ("/move/goal", "x", [range(-0.3, 0.4)]),
    ] {
        assert!(with(topic, path, &ranges), "{topic}");
    }
    for (topic, path, ranges) in [
        // Close, as what a robot measures.
        ("/executed", "x", [range(-0.3, 0.401)]),
        // Bounds that many numbers have.
        ("/door", "open", [range(0.0, 1.0)]),
        ("/goal", "x", [range(-0.3, 0.5)]),
        ("/tool_state", "x", [range(-0.3, 0.4)]),
    ] {
        assert!(!with(topic, path, &ranges), "{topic}");
    }
}

#[test]
fn a_finger_beside_the_command_of_a_gripper_is_noted() {
    let mut survey = arm(&["arm1", "finger_left"]);
    survey.topics[2].fields.push(numbers("gripper", &[range(0.0, 0.04)]));
    let text = draft([&survey], &known("t")).unwrap().to_string().replace("\n# ", " ");
    assert!(text.contains("finger_left may repeat the action gripper: keep it at first"), "{text}");
    assert_eq!(text.matches("may repeat the action").count(), 1, "beside positions alone: {text}");
    let text = draft([&arm(&["arm1", "finger_left"])], &known("t")).unwrap().to_string();
    assert!(!text.contains("may repeat the action"), "{text}");
}
