//! Tests of the agents' attempts and of their recordings.

#![allow(clippy::unwrap_used)]

use std::io::Cursor;

use gleaner_recording::{Severity, read_episode};

use super::*;

/// An attempt without pictures: its actions and its ending.
fn play(agent: &str, seed: u64) -> (Vec<[f32; ACTION_SIZE]>, Ending) {
    let mut actions = Vec::new();
    let sim = Sim::new(Task::PickCube, SimConfig::default(), seed);
    let ending = attempt(sim, agent.parse().unwrap(), seed, |_, action| actions.push(*action));
    (actions, ending)
}

fn successes(agent: &str, seeds: u64) -> usize {
    (0..seeds).filter(|&seed| play(agent, seed).1.success).count()
}

fn imperfect_kinds() -> impl Iterator<Item = AgentKind> {
    AgentKind::ALL.into_iter().filter(|kind| *kind != AgentKind::Expert)
}

#[test]
fn the_expert_succeeds() {
    let succeeded = successes("expert", 300);
    assert!(succeeded >= 297, "{succeeded} of 300");
}

#[test]
fn the_expert_takes_a_sensible_time() {
    let steps: usize = (0..100).map(|seed| play("expert", seed).0.len()).sum();
    assert!((2000..4500).contains(&steps), "{steps} steps in 100 attempts");
}

#[test]
fn every_agent_fails_nearly_always_at_grade_1_and_less_at_lower_grades() {
    for kind in imperfect_kinds() {
        let worst = successes(&format!("{kind}:1"), 100);
        let middling = successes(&format!("{kind}:0.5"), 100);
        assert!(worst <= 8, "{kind}: {worst} of 100 succeed at grade 1");
        assert!(middling > worst, "{kind}: {middling} of 100 at grade 0.5, {worst} at 1");
        assert_eq!(successes(&format!("{kind}:0"), 20), 20, "{kind}");
    }
}

#[test]
fn before_the_mark_an_agent_does_what_the_expert_does() {
    for kind in imperfect_kinds() {
        for seed in 0..40 {
            let (expert, _) = play("expert", seed);
            let (actions, ending) = play(&format!("{kind}:1"), seed);
            let mark = ending.went_wrong.unwrap() as usize;
            assert_eq!(actions[..mark], expert[..mark], "{kind}, seed {seed}");
            // An expert that has finished does nothing, so going on is also a departure.
            assert_ne!(actions.get(mark), expert.get(mark), "{kind}, seed {seed}");
        }
    }
}

#[test]
fn marks_differ_from_attempt_to_attempt() {
    for kind in imperfect_kinds() {
        let marks: std::collections::BTreeSet<_> =
            (0..40).filter_map(|seed| play(&format!("{kind}:1"), seed).1.went_wrong).collect();
        assert!(marks.len() >= 4, "{kind}: {marks:?}");
    }
}

#[test]
fn the_expert_has_no_mark_and_an_agent_is_marked_from_its_first_wrong_step() {
    let mut demonstration = short("expert");
    assert_eq!(demonstration.went_wrong, None);
    assert!(demonstration.mark().iter().all(|wrong| !wrong));
    demonstration.went_wrong = Some(2);
    assert_eq!(demonstration.mark()[..4], [false, false, true, true]);
    assert_eq!(demonstration.mark().len(), demonstration.steps());
}

fn short(agent: &str) -> Demonstration {
    let config = SimConfig { image: 16, ..SimConfig::default() };
    demonstrate(Task::PickCube, config, agent.parse().unwrap(), 11)
}

#[test]
fn the_same_seed_gives_the_same_bytes() {
    let write = |agent| short(agent).write_mcap(Cursor::new(Vec::new())).unwrap().into_inner();
    assert_eq!(write("noise:0.7"), write("noise:0.7"));
    assert_ne!(write("noise:0.7"), write("noise:0.6"));
}

#[test]
fn a_recording_reads_back_step_by_step() {
    let demonstration = short("expert");
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("attempt.mcap");
    demonstration.save_mcap(&path).unwrap();
    let reading = read_episode(&path, &task_spec(demonstration.task, &demonstration.config)).unwrap();
    let findings = &reading.report.findings;
    assert!(findings.iter().all(|finding| finding.severity == Severity::Note), "{findings:?}");
    let episode = reading.episode;
    assert_eq!(episode.steps(), demonstration.steps());
    let stamps: Vec<i64> = demonstration.observations.iter().map(|seen| seen.stamp_ns).collect();
    assert_eq!(episode.stamps(), stamps);
    assert_eq!(episode.action(), demonstration.actions.concat());
    let proprioception: Vec<f32> =
        demonstration.observations.iter().flat_map(|seen| seen.proprioception.clone()).collect();
    assert_eq!(episode.proprioception(), proprioception);
    let written = demonstration.observations.iter().flat_map(|seen| seen.frames.clone()).collect::<Vec<u8>>();
    same_pictures(episode.frames().as_ref(), &written, 16 * 16);
}

/// Depths must be equal; colors have been through JPEG.
fn same_pictures(read: &[u8], written: &[u8], pixels: usize) {
    assert_eq!(read.len(), written.len());
    for (read, written) in read.chunks(pixels * 5).zip(written.chunks(pixels * 5)) {
        assert_eq!(read[pixels * 3..], written[pixels * 3..]);
        let colors = read[..pixels * 3].iter().zip(&written[..pixels * 3]);
        let off: u32 = colors.map(|(a, b)| u32::from(a.abs_diff(*b))).sum();
        let mean = f64::from(off) / (pixels * 3) as f64;
        assert!(mean < 8.0, "colors are off by {mean} on average");
    }
}

#[test]
fn a_recording_names_its_agent_seed_outcome_and_mark_in_metadata() {
    let demonstration = short("early_release:1");
    let bytes = demonstration.write_mcap(Cursor::new(Vec::new())).unwrap().into_inner();
    let went_wrong = demonstration.went_wrong.unwrap().to_string();
    let entries = [("agent", "early_release:1"), ("seed", "11"), ("success", "false"), ("went_wrong", &went_wrong)];
    // An MCAP metadata record is not compressed: a map of texts, each behind its length.
    let text = |text: &str| [&u32::try_from(text.len()).unwrap().to_le_bytes(), text.as_bytes()].concat();
    for entry in entries.map(|(key, value)| [text(key), text(value)].concat()).into_iter().chain([text(METADATA)]) {
        assert!(bytes.windows(entry.len()).any(|part| part == entry), "{}", String::from_utf8_lossy(&entry));
    }
}
