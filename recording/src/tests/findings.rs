//! Each finding on a recording made for it, and the alignment of streams end to end.

use serde_json::json;

use super::scene::{Scene, numbers_only, read_bytes};
use crate::write::tests::{written, written_arm};
use crate::{Finding, FindingCode, RecordingError, Report, Severity};

fn only(report: &Report) -> &Finding {
    assert_eq!(report.findings.len(), 1, "{:?}", report.findings);
    &report.findings[0]
}

fn check(report: &Report, severity: Severity, code: FindingCode, subject: &str) -> Finding {
    let finding = only(report);
    assert_eq!(
        (finding.severity, finding.code, finding.subject.as_str()),
        (severity, code, subject)
    );
    finding.clone()
}

#[test]
fn a_sound_recording_has_none() {
    let report = Scene::steps(30).report(&numbers_only());
    assert_eq!(report.findings, []);
    assert_eq!(
        (report.steps, report.messages, report.dropped_ticks),
        (30, 90, 0)
    );
    assert_eq!(
        (report.duration_ns, report.mapping.as_str()),
        (2_900_000_000, "json")
    );
    assert!((report.rate_hz - 10.0).abs() < 1e-9);
}

#[test]
fn jittered_streams_meet_tick_by_tick_and_early_ticks_are_dropped() {
    // Joints up to 9 ms before or after the command; the tool begins two ticks later.
    let jitter = [-9, 4, 7, -3, 9];
    let scene = Scene::steps(10)
        .change("/joints", |at, stamp, _| {
            *stamp += jitter[at % 5];
            true
        })
        .change("/tool", |at, _, _| at >= 2);
    let reading = scene.read(&numbers_only()).unwrap();
    assert_eq!((reading.report.steps, reading.report.dropped_ticks), (8, 2));
    let episode = reading.episode;
    for (at, (row, action)) in episode
        .proprioception()
        .chunks(3)
        .zip(episode.action().chunks(2))
        .enumerate()
    {
        let value = (f32::from(u8::try_from(at + 2).unwrap())) * 0.1;
        for (found, wanted) in [
            (row[0], value),
            (row[1], -value),
            (row[2], value),
            (action[0], value),
        ] {
            assert!(
                (found - wanted).abs() < 1e-6,
                "step {at}: {found} for {wanted}"
            );
        }
    }
}

#[test]
fn joints_are_matched_by_name_whatever_their_order() {
    let mut spec = numbers_only();
    spec.mappings[0].fields[0].names = vec!["a".into(), "b".into()];
    let scene = Scene::steps(4).change("/joints", |at, _, content| {
        let swap = at % 2 == 1;
        content["name"] = if swap {
            json!(["b", "gripper", "a"])
        } else {
            json!(["a", "b", "gripper"])
        };
        content["position"] = if swap {
            json!([2, 9, 1])
        } else {
            json!([1, 2, 9])
        };
        true
    });
    let values = scene.read(&spec).unwrap().episode.proprioception();
    assert!(
        values.chunks(3).all(|row| row[..2] == [1.0, 2.0]),
        "{values:?}"
    );
    spec.mappings[0].fields[0].names[1] = "c".into();
    let finding = check(
        &scene.report(&spec),
        Severity::Error,
        FindingCode::MissingField,
        "joint_position",
    );
    assert!(
        finding.detail.contains("`c`") && finding.detail.contains("gripper"),
        "{}",
        finding.detail
    );
}

#[test]
fn messages_that_carry_other_joints_are_passed_over() {
    let mut spec = numbers_only();
    spec.mappings[0].fields[0].names = vec!["a".into(), "b".into()];
    let mut scene = Scene::steps(5).change("/joints", |_, _, content| {
        content["name"] = json!(["a", "b"]);
        true
    });
    for at in 0..5 {
        scene.add(
            "/joints",
            1001 + at * 100,
            json!({"name": ["gripper"], "position": [7.0]}),
        );
    }
    let reading = scene.read(&spec).unwrap();
    assert_eq!(reading.report.findings, []);
    assert!(
        reading
            .episode
            .proprioception()
            .chunks(3)
            .all(|row| row[0] == -row[1])
    );
}

#[test]
fn missing_topics_name_the_nearest_mapping() {
    let scene = Scene::steps(5).change("/tool", |_, _, _| false);
    let error = scene.read(&numbers_only()).unwrap_err();
    assert!(error.to_string().contains("/tool"), "{error}");
    let finding = check(
        &scene.report(&numbers_only()),
        Severity::Error,
        FindingCode::MissingTopic,
        "/tool",
    );
    assert!(finding.detail.contains("`json`"));
}

#[test]
fn the_mapping_that_fits_is_chosen() {
    let mut spec = numbers_only();
    let mut other = spec.mappings[0].clone();
    other.name = "other".into();
    other.fields[1].topic = "/elsewhere".into();
    spec.mappings.insert(0, other);
    assert_eq!(Scene::steps(5).read(&spec).unwrap().mapping, "json");
}

#[test]
fn missing_fields_and_wrong_sizes_say_what_there_is() {
    let scene = Scene::steps(5).change("/tool", |_, _, content| {
        *content = json!({"y": 1.0});
        true
    });
    let finding = check(
        &scene.report(&numbers_only()),
        Severity::Error,
        FindingCode::MissingField,
        "tool",
    );
    assert!(
        finding.detail.contains("`x`") && finding.detail.contains("has timestamp, y"),
        "{}",
        finding.detail
    );
    let scene = Scene::steps(5).change("/joints", |at, _, content| {
        content["position"] = json!(vec![0.0; if at == 3 { 3 } else { 2 }]);
        true
    });
    let finding = check(
        &scene.report(&numbers_only()),
        Severity::Error,
        FindingCode::WrongSize,
        "joint_position",
    );
    assert!(
        finding
            .detail
            .contains("message 3 gives 3 values, the task expects 2"),
        "{}",
        finding.detail
    );
}

#[test]
fn values_that_are_not_finite_name_value_and_step() {
    let scene = Scene::steps(5).change("/command", |at, _, content| {
        if at == 3 {
            content["values"][1] = json!(1e300);
        }
        true
    });
    let finding = check(
        &scene.report(&numbers_only()),
        Severity::Error,
        FindingCode::NotFinite,
        "command[1]",
    );
    assert_eq!(finding.first_step, Some(3));
}

#[test]
fn gaps_are_told_for_the_clock_and_for_a_stream() {
    let clock = Scene::steps(12).change("/command", |at, _, _| !(4..8).contains(&at));
    let finding = check(
        &clock.report(&numbers_only()),
        Severity::Warning,
        FindingCode::Gap,
        "clock",
    );
    assert_eq!(finding.first_step, Some(4));
    assert!(finding.detail.contains("500 ms"), "{}", finding.detail);
    let stream = Scene::steps(12).change("/tool", |at, _, _| !(4..8).contains(&at));
    let finding = check(
        &stream.report(&numbers_only()),
        Severity::Warning,
        FindingCode::Gap,
        "/tool",
    );
    assert_eq!(finding.first_step, Some(6));
    let held = Scene::steps(12).change("/tool", |at, _, _| at == 0);
    assert_eq!(held.report(&numbers_only()).findings, []);
}

#[test]
fn a_frozen_joint_is_told_once_and_a_resting_arm_not_at_all() {
    let mut spec = numbers_only();
    spec.proprioception[0].size = 3;
    let scene = |joints: [f64; 3]| {
        Scene::steps(30).change("/joints", move |at, _, content| {
            let at = f64::from(u32::try_from(at).unwrap());
            content["position"] = json!(joints.map(|speed| 0.5 + at * speed));
            true
        })
    };
    let finding = check(
        &scene([0.1, 0.0, 0.2]).report(&spec),
        Severity::Warning,
        FindingCode::FrozenJoint,
        "joint_position[1]",
    );
    assert_eq!(finding.first_step, None);
    assert_eq!(scene([0.0, 0.0, 0.2]).report(&spec).findings, []);
    assert_eq!(scene([0.0, 0.0, 0.0]).report(&spec).findings, []);
    spec.proprioception[0].name = "joint_velocity".into();
    spec.mappings[0].fields[0].field = "joint_velocity".into();
    assert_eq!(scene([0.1, 0.0, 0.2]).report(&spec).findings, []);
}

#[test]
fn reversed_stamps_are_put_in_order() {
    let scene = Scene::steps(6).change("/tool", |at, stamp, _| {
        *stamp = [1000, 1200, 1100, 1300, 1400, 1500][at];
        true
    });
    let reading = scene.read(&numbers_only()).unwrap();
    check(
        &reading.report,
        Severity::Warning,
        FindingCode::TimeReversed,
        "/tool",
    );
    let tool: Vec<f32> = reading
        .episode
        .proprioception()
        .chunks(3)
        .map(|row| row[2])
        .collect();
    assert_eq!(tool, [0.0, 0.2, 0.1, 0.3, 0.4, 0.5]);
}

#[test]
fn another_rate_too_few_steps_and_bad_messages_are_told() {
    let mut slow = numbers_only();
    slow.rate_hz = 20.0;
    check(
        &Scene::steps(12).report(&slow),
        Severity::Warning,
        FindingCode::OffRate,
        "clock",
    );
    check(
        &Scene::steps(1).report(&numbers_only()),
        Severity::Error,
        FindingCode::TooShort,
        "file",
    );
    let scene = Scene::steps(5).change("/tool", |_, _, content| {
        *content = json!(null);
        true
    });
    let report = scene.report(&numbers_only());
    assert!(
        report
            .findings
            .iter()
            .any(|finding| finding.code == FindingCode::BadMessage),
        "{:?}",
        report.findings
    );
}

#[test]
fn a_fast_clock_is_thinned_to_the_rate() {
    let mut scene = Scene::steps(10);
    for at in 0..9 {
        scene.add("/command", 1050 + at * 100, json!({"values": [9, 9]}));
    }
    // In the file's order the extra messages come late, but their stamps count.
    let reading = scene.read(&numbers_only()).unwrap();
    assert_eq!(
        (reading.report.steps, reading.report.dropped_ticks),
        (10, 9)
    );
    assert!(reading.episode.action().chunks(2).all(|row| row[0] < 1.0));
}

#[test]
fn stamps_of_another_clock_give_way_to_log_times_when_a_topic_has_none() {
    let mut scene = Scene::steps(6);
    for message in &mut scene.messages {
        message.2 += 5_000_000;
        if message.0 == "/tool" {
            message.1 = None;
        }
    }
    let reading = scene.read(&numbers_only()).unwrap();
    let finding = only(&reading.report);
    assert_eq!(
        (finding.severity, finding.code),
        (Severity::Note, FindingCode::MixedClocks)
    );
    assert_eq!(reading.episode.stamps()[0], 5_001_000_000_000);
    assert_eq!(reading.report.steps, 6);
}

#[test]
fn images_of_another_size_are_told_once() {
    let mut spec = written_arm();
    spec.cameras[0].width = 8;
    let Err(RecordingError::Rejected(report)) = read_bytes(&written(5), &spec) else {
        panic!("accepted")
    };
    let codes: Vec<_> = report
        .findings
        .iter()
        .map(|finding| (finding.code, finding.subject.as_str()))
        .collect();
    assert_eq!(
        codes,
        [
            (FindingCode::WrongSize, "/camera/front/color"),
            (FindingCode::WrongSize, "/camera/front/depth")
        ]
    );
    assert!(
        report.findings[0].detail.contains("8×16")
            && report.findings[0].detail.contains("5 images")
    );
}

#[test]
fn a_camera_on_a_topic_of_numbers_is_a_broken_image() {
    let mut spec = written_arm();
    spec.mappings[0].cameras[0].color = "/robot/action".into();
    let Err(RecordingError::Rejected(report)) = read_bytes(&written(5), &spec) else {
        panic!("accepted")
    };
    check(
        &report,
        Severity::Error,
        FindingCode::BrokenImage,
        "/robot/action",
    );
}
