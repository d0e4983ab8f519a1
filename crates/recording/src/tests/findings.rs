//! Each finding on a recording made for it.

use serde_json::json;

use super::scene::{Scene, check, numbers_only, read_bytes};
use crate::write::tests::{written, written_arm};
use crate::{FindingCode, RecordingError, Severity};

#[test]
fn sound_recording_has_no_findings() {
    let report = Scene::steps(30).report(&numbers_only());
    assert_eq!(report.findings, []);
    assert_eq!((report.steps, report.messages, report.dropped_ticks), (30, 90, 0));
    assert_eq!((report.duration_ns, report.mapping.as_str()), (2_900_000_000, "json"));
    assert!((report.rate_hz - 10.0).abs() < 1e-9);
}

#[test]
fn missing_topics_name_the_nearest_mapping() {
    let scene = Scene::steps(5).change("/tool", |_, _, _| false);
    let error = scene.read(&numbers_only()).unwrap_err();
    assert!(error.to_string().contains("/tool"), "{error}");
    let finding = check(&scene.report(&numbers_only()), Severity::Error, FindingCode::MissingTopic, "/tool");
    assert!(finding.detail.contains("`json`"));
    for part in ["/command, /joints", "correct the mapping"] {
        assert!(finding.detail.contains(part), "{part}: {}", finding.detail);
    }
    let mut spec = numbers_only();
    spec.mappings[0].fields[0].topic = "/joint".into();
    let finding = check(&Scene::steps(5).report(&spec), Severity::Error, FindingCode::MissingTopic, "/joint");
    assert!(finding.detail.contains("did you mean /joints?"), "{}", finding.detail);
}

#[test]
fn missing_fields_and_wrong_sizes_name_the_existing_ones() {
    let scene = Scene::steps(5).change("/tool", |_, _, content| {
        *content = json!({"y": 1.0});
        true
    });
    let finding = check(&scene.report(&numbers_only()), Severity::Error, FindingCode::MissingField, "tool");
    assert!(finding.detail.contains("`x`") && finding.detail.contains("has timestamp, y"), "{}", finding.detail);
    let scene = Scene::steps(5).change("/joints", |at, _, content| {
        content["position"] = json!(vec![0.0; if at == 3 { 3 } else { 2 }]);
        true
    });
    let finding = check(&scene.report(&numbers_only()), Severity::Error, FindingCode::WrongSize, "joint_position");
    assert!(finding.detail.contains("message 3 gives 3 values, the task expects 2"), "{}", finding.detail);
}

#[test]
fn values_that_are_not_finite_name_value_and_step() {
    let scene = Scene::steps(5).change("/command", |at, _, content| {
        if at == 3 {
            content["values"][1] = json!(1e300);
        }
        true
    });
    let finding = check(&scene.report(&numbers_only()), Severity::Error, FindingCode::NotFinite, "command[1]");
    assert_eq!(finding.first_step, Some(3));
}

#[test]
fn a_null_in_json_is_a_number_that_is_not_finite_and_moves_no_other() {
    let mut spec = numbers_only();
    spec.mappings[0].fields[0].paths = vec!["position[1:3]".into()];
    let scene = Scene::steps(5).change("/joints", |at, _, content| {
        content["position"] = if at == 2 { json!([null, 5, 6, 7]) } else { json!([4, 5, 6, 7]) };
        true
    });
    let values = scene.read(&spec).unwrap().episode.proprioception();
    assert!(values.chunks(3).all(|row| row[..2] == [5.0, 6.0]), "{values:?}");
    spec.mappings[0].fields[0].paths = vec!["position[0:2]".into()];
    let finding = check(&scene.report(&spec), Severity::Error, FindingCode::NotFinite, "joint_position[0]");
    assert_eq!(finding.first_step, Some(2));
}

#[test]
fn gaps_of_the_clock_and_of_a_stream_are_findings() {
    let clock = Scene::steps(12).change("/command", |at, _, _| !(4..8).contains(&at));
    let finding = check(&clock.report(&numbers_only()), Severity::Warning, FindingCode::Gap, "clock");
    assert_eq!(finding.first_step, Some(4));
    assert!(finding.detail.contains("after the one before, at most 500 ms"), "{}", finding.detail);
    let stream = Scene::steps(12).change("/tool", |at, _, _| !(4..8).contains(&at));
    let finding = check(&stream.report(&numbers_only()), Severity::Warning, FindingCode::Gap, "/tool");
    assert_eq!(finding.first_step, Some(6));
    // A stream of half the rate that loses one message, and three.
    let slow = |lost: &'static [usize]| {
        Scene::steps(24).change("/tool", move |at, _, _| at % 2 == 0 && !lost.contains(&at)).report(&numbers_only())
    };
    assert_eq!(slow(&[8]).findings, []);
    let finding = check(&slow(&[8, 10, 12]), Severity::Warning, FindingCode::Gap, "/tool");
    assert!(finding.detail.contains("2.5 periods of 200 ms old, at most 700 ms"), "{}", finding.detail);
    // One of a tenth of the rate was meant to be faster.
    let rare = Scene::steps(24).change("/tool", |at, _, _| at % 12 == 0);
    check(&rare.report(&numbers_only()), Severity::Warning, FindingCode::Gap, "/tool");
    let mut switch = numbers_only();
    let bounds = [-10.0, 10.0].map(|bound| Some(gleaner_core::Bound::All(bound)));
    let tool = switch.proprioception.iter().position(|field| field.name == "tool").unwrap();
    let field = gleaner_core::FieldSpec { binary: true, ..switch.proprioception.remove(tool) };
    let [minimum, maximum] = bounds;
    switch.action.push(gleaner_core::FieldSpec { minimum, maximum, ..field });
    assert_eq!(rare.report(&switch).findings, [], "a switch is held until the next message");
    let held = Scene::steps(12).change("/tool", |at, _, _| at == 0);
    assert_eq!(held.report(&numbers_only()).findings, []);
}

#[test]
fn a_frozen_joint_is_one_finding_and_a_resting_arm_has_no_finding() {
    let mut spec = numbers_only();
    spec.proprioception[0].size = 3;
    let scene = |joints: [f64; 3]| {
        Scene::steps(30).change("/joints", move |at, _, content| {
            let at = f64::from(u32::try_from(at).unwrap());
            content["position"] = json!(joints.map(|speed| 0.5 + at * speed));
            true
        })
    };
    let finding =
        check(&scene([0.1, 0.0, 0.2]).report(&spec), Severity::Warning, FindingCode::FrozenJoint, "joint_position[1]");
    assert_eq!(finding.first_step, None);
    assert_eq!(scene([0.0, 0.0, 0.2]).report(&spec).findings, []);
    assert_eq!(scene([0.0, 0.0, 0.0]).report(&spec).findings, []);
    spec.proprioception[0].name = "joint_velocity".into();
    spec.mappings[0].fields[0].field = "joint_velocity".into();
    assert_eq!(scene([0.1, 0.0, 0.2]).report(&spec).findings, []);
}

#[test]
fn an_action_outside_of_its_limits_is_named_with_what_it_becomes() {
    let of = |minimum: Option<f32>, maximum: Option<f32>| {
        let mut spec = numbers_only();
        let [minimum, maximum] = [minimum, maximum].map(|bound| bound.map(gleaner_core::Bound::All));
        (spec.action[0].minimum, spec.action[0].maximum) = (minimum, maximum);
        Scene::steps(12).report(&spec)
    };
    // The first value of the command goes from 0 to 1.1, the second is 1.
    assert_eq!(of(Some(0.0), Some(1.1)).findings, []);
    assert_eq!(of(Some(0.0), Some(1.095)).findings, [], "less than a hundredth of the range");
    assert_eq!(of(None, Some(1.2)).findings, []);
    let finding = check(&of(Some(0.5), Some(1.05)), Severity::Warning, FindingCode::OutsideLimits, "command[0]");
    assert_eq!(finding.first_step, Some(0));
    let part = "at 6 of 12 steps the action is outside of its limits, minimum 0.5 and maximum 1.05, and is learned as the \
                nearest one: it is 0.000 to 1.100";
    assert!(finding.detail.starts_with(part), "{}", finding.detail);
    let least = check(&of(Some(0.2), None), Severity::Warning, FindingCode::OutsideLimits, "command[0]");
    assert!(least.detail.starts_with("at 2 of 12 steps the action is outside of its limits, minimum 0.2, and"));
}

#[test]
fn another_rate_too_few_steps_and_bad_messages_are_findings() {
    let mut slow = numbers_only();
    slow.rate_hz = 20.0;
    let off = check(&Scene::steps(12).report(&slow), Severity::Warning, FindingCode::OffRate, "clock");
    assert_eq!(
        off.detail,
        "the steps of /command come at 10.0 Hz and the task has 20 Hz: set `rate_hz = 10.0`, or in the mapping `json` as \
         `clock` a topic of 20 Hz"
    );
    check(&Scene::steps(1).report(&numbers_only()), Severity::Error, FindingCode::TooShort, "file");
    let scene = Scene::steps(5).change("/tool", |_, _, content| {
        *content = json!(null);
        true
    });
    let report = scene.report(&numbers_only());
    assert!(report.findings.iter().any(|finding| finding.code == FindingCode::BadMessage), "{:?}", report.findings);
}

#[test]
fn images_of_another_size_are_one_finding() {
    let mut spec = written_arm();
    spec.cameras[0].width = 8;
    let Err(RecordingError::Rejected(report)) = read_bytes(&written(5), &spec) else { panic!("accepted") };
    let codes: Vec<_> = report.findings.iter().map(|finding| (finding.code, finding.subject.as_str())).collect();
    assert_eq!(
        codes,
        [(FindingCode::WrongSize, "/camera/front/color"), (FindingCode::WrongSize, "/camera/front/depth")]
    );
    assert!(report.findings[0].detail.contains("8×16") && report.findings[0].detail.contains("5 images"));
}

#[test]
fn a_camera_on_a_topic_of_numbers_is_a_broken_image() {
    let mut spec = written_arm();
    spec.mappings[0].cameras[0].color = "/robot/action".into();
    let Err(RecordingError::Rejected(report)) = read_bytes(&written(5), &spec) else { panic!("accepted") };
    check(&report, Severity::Error, FindingCode::BrokenImage, "/robot/action");
}
