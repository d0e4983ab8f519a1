//! Which fields are commands, and which are measurements.

use super::*;

/// The names of observations and actions in a draft of one topic with these fields, and its doubts.
fn roles(name: &str, paths: &[&str]) -> (Vec<String>, Vec<String>, usize) {
    // Each has values of its own, so that none is a copy of another.
    let of = |(high, path): (u8, &&str)| numbers(path, &[range(-1.0, 1.0), range(0.0, 5.0 + f64::from(high))]);
    let fields = (0..).zip(paths).map(of).collect();
    let survey = recording(vec![camera("/front", "json", (96, 96)), topic(name, "json", fields)]);
    let draft = draft([&survey], &known("t")).unwrap();
    let names = |fields: &[gleaner_recording::FieldSpec]| fields.iter().map(|field| field.name.clone()).collect();
    (names(&draft.spec.proprioception), names(&draft.spec.action), draft.doubts().len())
}

#[test]
fn fields_beside_a_command_are_commands() {
    for (name, paths, observations, actions) in [
        ("/policy_out", &["target", "grip"][..], &[][..], &["target", "grip"][..]),
        ("/leader", &["action", "gripper"], &[], &["action", "gripper"]),
        ("/leader", &["command.arm", "desired_gripper"], &[], &["arm", "desired_gripper"]),
        // Each part of a message has its own.
        (
            "/robot",
            &["robot.q", "robot.gripper", "target.arm", "target.gripper"],
            &["q", "gripper"],
            &["arm", "target_gripper"],
        ),
        // Measurements beside commands of a topic that is named like commands.
        (
            "/teleop",
            &["robot_state_q", "robot.q", "action", "gripper"],
            &["robot_state_q", "q"],
            &["action", "gripper"],
        ),
        ("/cmd", &["q", "gripper"], &[], &["q", "gripper"]),
        // The velocities of the same joints are a comment.
        ("/log", &["action", "robot0_eef_pos", "qpos", "dq"], &["robot0_eef_pos", "qpos"], &["action"]),
    ] {
        let (found, commands, doubts) = roles(name, paths);
        assert_eq!((found, commands, doubts), (owned(observations), owned(actions), 0), "{name} {paths:?}");
    }
}

fn owned(names: &[&str]) -> Vec<String> {
    names.iter().map(|&name| name.to_owned()).collect()
}

#[test]
fn a_field_between_commands_and_measurements_is_a_doubt() {
    for (name, paths, observations) in [
        ("/log", &["action", "qpos", "gripper"][..], &["qpos", "gripper"][..]),
        ("/policy_out", &["target", "ee_pose"], &["ee_pose"]),
        ("/step", &["action", "other"], &["other"]),
    ] {
        let (found, _, doubts) = roles(name, paths);
        assert_eq!((found, doubts), (owned(observations), 1), "{name} {paths:?}");
    }
}

#[test]
fn each_role_has_its_reason() {
    let fields = ["ee_pose.position", "mode"].map(|path| numbers(path, &[range(0.0, 1.0)]));
    let out = ["target", "grip"].map(|path| numbers(path, &[range(-1.0, 5.0)]));
    let survey = recording(vec![topic("/robot", "json", fields.into()), topic("/out", "json", out.into())]);
    let text = draft([&survey], &known("t")).unwrap().to_string();
    for part in [
        "Proprioception, because it is named like the position of the end effector.",
        "name = \"ee_pose_position\"",
        "because it is not named like a command; remove it if a robot cannot send it",
        "An action, because target of the same topic is one.",
    ] {
        assert!(text.contains(part), "{part}: {text}");
    }
}

/// A switch on a topic of its own is a command where one loop sends both.
#[test]
fn a_switch_that_comes_as_often_as_the_commands_is_one() {
    let of = |name: &str, rate_hz, values: &[f64]| {
        let high = values.iter().copied().fold(0.0, f64::max);
        let data = SurveyedField { values: values.to_vec(), ..numbers("data", &[range(0.0, high)]) };
        let switch = SurveyedTopic { rate_hz, ..topic(name, "cdr", vec![data]) };
        let commands = topic("/cmd_vel", "cdr", vec![numbers("x", &[range(-0.2, 0.3)])]);
        let draft =
            draft([&recording(vec![camera("/front", "cdr", (96, 96)), switch, commands])], &known("t")).unwrap();
        let action = draft.spec.action.iter().find(|field| field.name != "cmd_vel").cloned();
        (action, format!("{draft}{}", draft.doubts().join("\n")))
    };
    let (press, text) = of("/stamp/press", 20.2, &[0.0, 1.0]);
    let press = press.unwrap();
    assert_eq!(
        (press.minimum.clone(), press.maximum.clone(), press.binary),
        (Some(Bound::All(0.0)), Some(Bound::All(1.0)), true)
    );
    assert!(text.replace("\n# ", " ").contains("it is on or off and comes as often as /cmd_vel"), "{text}");
    // What is open is a doubt, with the options that take it as a command.
    let open = of("/stamp/press", 2.0, &[0.0, 1.0]).1;
    assert!(open.contains("press of /stamp/press is on or off"), "{open}");
    assert!(open.contains("draft with --action /cmd_vel --action /stamp/press if it is a command"), "{open}");
    assert!(!of("/stamp/contact1", 2.0, &[0.0, 1.0]).1.contains("on or off"), "a sensor");
    for (name, rate, values) in [
        ("/stamp/press", 50.0, &[0.0, 1.0][..]),
        ("/stamp/press", 20.0, &[0.0, 0.4]),
        ("/stamp/press", 20.0, &[]),
        ("/stamp/contact1", 20.0, &[0.0, 1.0]),
        ("/gripper/closed", 20.0, &[0.0, 1.0]),
        ("/stamp_state", 20.0, &[0.0, 1.0]),
    ] {
        assert_eq!(of(name, rate, values).0, None, "{name} {rate} {values:?}");
    }
}

/// A lamp that is sent when it changes, beside the commands of its device.
#[test]
fn a_switch_in_a_namespace_of_commands_is_one_unless_something_is_measured_there() {
    let of = |others: Vec<SurveyedTopic>| {
        let data = SurveyedField { values: vec![0.0, 1.0], ..numbers("data", &[range(0.0, 1.0)]) };
        let lamp = SurveyedTopic { rate_hz: 2.3, ..topic("/wick/lamp", "cdr", vec![data]) };
        let commands = topic("/wick/rate_cmd", "cdr", vec![numbers("x", &[range(-0.2, 0.3)])]);
        draft([&recording([vec![camera("/front", "cdr", (96, 96)), lamp, commands], others].concat())], &known("t"))
            .unwrap()
    };
    let states = |name: &str| topic(name, "cdr", vec![numbers("position", &[range(-1.0, 1.0)])]);
    let alone = of(vec![states("/joint_states")]);
    assert!(alone.spec.action.iter().any(|field| field.name == "lamp" && field.binary), "{alone}");
    let text = alone.to_string().replace("\n# ", " ");
    assert!(
        text.contains("it is on or off and shares /wick with /wick/rate_cmd and nothing that is measured"),
        "{text}"
    );
    let beside = of(vec![states("/wick/joint_states")]);
    assert!(beside.spec.action.iter().all(|field| field.name != "lamp"), "{beside}");
    assert!(beside.doubts()[0].starts_with("lamp of /wick/lamp is on or off"), "{:?}", beside.doubts());
}

#[test]
fn a_switch_is_judged_only_where_no_action_is_named() {
    let survey = |encoding, values: &[f64]| {
        let data =
            SurveyedField { values: values.to_vec(), ..numbers("data", &[range(0.0, values.len() as f64 - 1.0)]) };
        let commands = topic("/cmd_vel", encoding, vec![numbers("x", &[range(-0.2, 0.3)])]);
        recording(vec![topic("/press", encoding, vec![data]), commands])
    };
    let both = [0.0, 1.0];
    let seen = |draft: Draft| draft.spec.proprioception.iter().map(|field| field.name.clone()).collect::<Vec<_>>();
    let named = Known { name: "t".into(), action: vec!["/cmd_vel".into()] };
    assert_eq!(seen(draft([&survey("cdr", &both)], &named).unwrap()), ["press"], "it stays an observation");
    // In one of two ways it was never set off.
    let ways = [survey("cdr", &both), survey("json", &[0.0])];
    assert_eq!(seen(draft(&ways, &known("t")).unwrap()), ["press"]);
}

/// Commands under names of a lab's own: the message is sent to robots, and a switch beside it is a command too.
#[test]
fn a_message_for_robots_is_a_command_where_no_name_is_one() {
    let twist = |name: &str| SurveyedTopic {
        schema: "geometry_msgs/msg/TwistStamped".into(),
        ..topic(name, "cdr", vec![numbers("twist.linear.x", &[range(-0.2, 0.3)])])
    };
    let data = SurveyedField { values: vec![0.0, 1.0], ..numbers("data", &[range(0.0, 1.0)]) };
    let pinch = |name: &str| SurveyedTopic { rate_hz: 0.2, ..topic(name, "cdr", vec![data.clone()]) };
    let joints = || topic("/joint_states", "cdr", vec![numbers("position", &[range(-1.0, 1.0)])]);
    let of = |topics: Vec<SurveyedTopic>| {
        let survey = recording([vec![camera("/front", "cdr", (96, 96)), joints()], topics].concat());
        draft([&survey], &known("t"))
    };
    let names = |draft: &Draft| draft.spec.action.iter().map(|field| field.name.clone()).collect::<Vec<_>>();
    let drafted = of(vec![twist("/box/twist"), pinch("/box/pinch")]).unwrap();
    assert_eq!(names(&drafted), ["twist", "pinch"], "{drafted}");
    let text = drafted.to_string().replace("\n# ", " ");
    assert!(text.contains("and geometry_msgs/msg/TwistStamped is sent to robots as a rule"), "{text}");
    // Topics named like commands come first; a topic named like a measurement is not a command.
    let named = of(vec![twist("/tcp/twist"), topic("/cmd", "cdr", vec![numbers("x", &[range(0.0, 1.0)])])]).unwrap();
    assert_eq!(names(&named), ["cmd"], "{named}");
    assert!(of(vec![twist("/tcp/twist")]).unwrap_err().contains("name them with --action TOPIC"));
    // A caller that names the commands knows that the others are measured.
    let other = topic("/wheels", "cdr", vec![numbers("x", &[range(0.0, 1.0)])]);
    let survey = recording(vec![camera("/front", "cdr", (96, 96)), twist("/vehicle/twist"), other]);
    let named = draft([&survey], &Known { name: "t".into(), action: vec!["/wheels".into()] }).unwrap();
    assert_eq!(names(&named), ["wheels"], "{named}");
    assert!(named.spec.proprioception.iter().any(|field| field.name == "twist"), "{named}");
}
