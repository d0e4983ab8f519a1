//! The messages of each step, end to end.

use serde_json::json;

use super::scene::{Scene, check, numbers_only, only};
use crate::{FindingCode, Severity};

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
    assert_eq!(reading.report.findings, [], "two ticks are no finding");
    let episode = reading.episode;
    for (at, (row, action)) in episode.proprioception().chunks(3).zip(episode.action().chunks(2)).enumerate() {
        let value = (f32::from(u8::try_from(at + 2).unwrap())) * 0.1;
        for (found, wanted) in [(row[0], value), (row[1], -value), (row[2], value), (action[0], value)] {
            assert!((found - wanted).abs() < 1e-6, "step {at}: {found} for {wanted}");
        }
    }
}

#[test]
fn joints_are_matched_by_name_whatever_their_order() {
    let mut spec = numbers_only();
    spec.mappings[0].fields[0].names = vec!["a".into(), "b".into()];
    let scene = Scene::steps(4).change("/joints", |at, _, content| {
        let swap = at % 2 == 1;
        content["name"] = if swap { json!(["b", "gripper", "a"]) } else { json!(["a", "b", "gripper"]) };
        content["position"] = if swap { json!([2, 9, 1]) } else { json!([1, 2, 9]) };
        true
    });
    let values = scene.read(&spec).unwrap().episode.proprioception();
    assert!(values.chunks(3).all(|row| row[..2] == [1.0, 2.0]), "{values:?}");
    spec.mappings[0].fields[0].names[1] = "c".into();
    let finding = check(&scene.report(&spec), Severity::Error, FindingCode::MissingField, "joint_position");
    assert!(finding.detail.contains("`c`") && finding.detail.contains("gripper"), "{}", finding.detail);
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
        scene.add("/joints", 1001 + at * 100, json!({"name": ["gripper"], "position": [7.0]}));
    }
    let reading = scene.read(&spec).unwrap();
    assert_eq!(reading.report.findings, []);
    assert!(reading.episode.proprioception().chunks(3).all(|row| row[0] == -row[1]));
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
fn reversed_stamps_are_put_in_order() {
    let scene = Scene::steps(6).change("/tool", |at, stamp, _| {
        *stamp = [1000, 1200, 1100, 1300, 1400, 1500][at];
        true
    });
    let reading = scene.read(&numbers_only()).unwrap();
    check(&reading.report, Severity::Warning, FindingCode::TimeReversed, "/tool");
    let tool: Vec<f32> = reading.episode.proprioception().chunks(3).map(|row| row[2]).collect();
    assert_eq!(tool, [0.0, 0.2, 0.1, 0.3, 0.4, 0.5]);
}

#[test]
fn a_topic_that_begins_late_is_named_with_what_it_costs() {
    let reading = Scene::steps(12).change("/tool", |at, _, _| at >= 8).read(&numbers_only()).unwrap();
    assert_eq!(reading.report.steps, 4);
    let finding = check(&reading.report, Severity::Warning, FindingCode::LateStart, "/tool");
    assert!(finding.detail.contains("0.80 s"), "{}", finding.detail);
}

#[test]
fn a_fast_clock_is_thinned_to_the_rate() {
    let mut scene = Scene::steps(10);
    for at in 0..9 {
        scene.add("/command", 1050 + at * 100, json!({"values": [9, 9]}));
    }
    // In the file's order the extra messages come late, but their stamps count.
    let reading = scene.read(&numbers_only()).unwrap();
    assert_eq!((reading.report.steps, reading.report.dropped_ticks), (10, 9));
    assert!(reading.episode.action().chunks(2).all(|row| row[0] < 1.0));
}

#[test]
fn log_times_replace_stamps_of_another_clock() {
    let mut scene = Scene::steps(6);
    for message in &mut scene.messages {
        message.2 += 5_000_000;
        if message.0 == "/tool" {
            message.1 = None;
        }
    }
    let reading = scene.read(&numbers_only()).unwrap();
    let finding = only(&reading.report);
    assert_eq!((finding.severity, finding.code), (Severity::Note, FindingCode::MixedClocks));
    assert_eq!(reading.episode.stamps()[0], 5_001_000_000_000);
    assert_eq!(reading.report.steps, 6);
}
