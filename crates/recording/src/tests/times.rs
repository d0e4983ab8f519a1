//! Header stamps of other clocks than the recorder's, end to end.

use serde_json::json;

use super::scene::{Scene, check, numbers_only};
use crate::{FindingCode, Reading, Severity};

/// The steps of [`Scene::steps`] from this stamp on, each with its own message of the tool.
fn assert_steps(reading: &Reading, first_ms: i64) {
    let stamps: Vec<i64> = (0..6).map(|at| (first_ms + at * 100) * 1_000_000).collect();
    assert_eq!(reading.episode.stamps(), stamps);
    let tool: Vec<f32> = reading.episode.proprioception().chunks(3).map(|row| row[2]).collect();
    assert_eq!(tool, [0.0, 0.1, 0.2, 0.3, 0.4, 0.5]);
}

/// A recording whose stamps begin at zero, which stands for a message without a stamp.
fn simulated() -> Scene {
    let mut scene = Scene::steps(6);
    for message in &mut scene.messages {
        message.1 = Some(message.2 - 1000);
        message.2 += 1_700_000_000_000;
    }
    scene
}

#[test]
fn the_first_step_of_simulated_time_is_the_one_at_zero() {
    let reading = simulated().read(&numbers_only()).unwrap();
    assert_eq!(reading.report.findings, []);
    assert_steps(&reading, 0);
}

#[test]
fn a_message_without_a_stamp_among_those_of_another_clock_keeps_its_place() {
    let reading = simulated().change("/tool", |at, stamp, _| {
        *stamp *= i64::from(at != 3);
        true
    });
    let reading = reading.read(&numbers_only()).unwrap();
    assert_eq!(reading.report.findings, []);
    assert_steps(&reading, 0);
}

#[test]
fn topics_of_two_clocks_meet_by_log_times() {
    for shift in [-5_000_000, 5_000_000] {
        let scene = Scene::steps(6).change("/tool", |_, stamp, _| {
            *stamp += shift;
            true
        });
        let reading = scene.read(&numbers_only()).unwrap();
        let finding = check(&reading.report, Severity::Note, FindingCode::MixedClocks, "/tool");
        assert!(finding.detail.contains("those of /command"), "{}", finding.detail);
        assert_steps(&reading, 1000);
    }
}

#[test]
fn one_message_of_the_future_is_of_another_clock() {
    let scene = Scene::steps(6).change("/tool", |at, stamp, _| {
        *stamp += 5_000_000;
        at == 0
    });
    let reading = scene.read(&numbers_only()).unwrap();
    check(&reading.report, Severity::Note, FindingCode::MixedClocks, "/tool");
    assert_eq!(reading.report.steps, 6);
}

#[test]
fn goals_of_long_ago_are_held() {
    let sent_again = Scene::steps(6).change("/tool", |_, stamp, _| {
        *stamp = -5_000_000;
        true
    });
    // An episode that is cut out begins with the earlier messages of such a topic.
    let mut latched = Scene::steps(6).without("/tool");
    for (ms, x) in [(-5_000_000, 1.0), (-4_000_000, 2.0)] {
        latched.messages.insert(0, ("/tool", Some(ms), 1000, json!({ "x": x })));
    }
    for scene in [sent_again, latched] {
        let report = scene.report(&numbers_only());
        assert!(report.steps == 6, "{report:?}");
        assert!(report.findings.iter().all(|finding| finding.code != FindingCode::MixedClocks), "{report:?}");
    }
}

#[test]
fn a_clock_that_is_seconds_off_is_a_warning() {
    let shifted = |ms: i64| {
        let scene = Scene::steps(60).change("/tool", |_, stamp, _| {
            *stamp += ms;
            true
        });
        let mut findings = scene.report(&numbers_only()).findings;
        findings.retain(|finding| finding.code == FindingCode::MixedClocks);
        findings
    };
    for (ms, text) in [(-3000, "3.0 s before those of /command"), (2000, "2.0 s after those of /command")] {
        let findings = shifted(ms);
        assert_eq!((findings.len(), findings[0].severity), (1, Severity::Warning), "{findings:?}");
        assert_eq!(findings[0].subject, "/tool");
        assert!(findings[0].detail.contains(text), "{}", findings[0].detail);
    }
    assert_eq!(shifted(-500), [], "messages that are logged half a second late");
}

#[test]
fn a_recording_of_a_recording_and_a_converted_one_have_no_findings() {
    let mut replayed = Scene::steps(60);
    replayed.messages.iter_mut().for_each(|message| message.2 += 5_000_000);
    // Each topic after the other, at the time of the conversion.
    let mut converted = Scene::steps(60);
    converted.messages.sort_by_key(|message| message.0);
    (5_000_000..).zip(&mut converted.messages).for_each(|(ms, message)| message.2 = ms);
    for scene in [replayed, converted] {
        let reading = scene.read(&numbers_only()).unwrap();
        assert_eq!((reading.report.steps, reading.report.findings), (60, vec![]));
    }
}
