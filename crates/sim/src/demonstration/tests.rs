//! Tests of attempts and their recordings.

use std::io::Cursor;

use gleaner_recording::{Severity, read_episode};

use super::*;

/// An attempt without images: its actions and its end.
fn play(task: Task, agent: &str, seed: u64) -> (Vec<[f32; ACTION_SIZE]>, Ending) {
    let mut actions = Vec::new();
    let sim = Sim::new(task, SimConfig::default(), seed);
    let ending = attempt(sim, agent.parse().unwrap(), seed, |_, action| actions.push(*action));
    (actions, ending)
}

fn successes(task: Task, agent: &str, seeds: u64) -> usize {
    (0..seeds).filter(|&seed| play(task, agent, seed).1.success).count()
}

/// Every imperfect kind at every task.
fn imperfect() -> impl Iterator<Item = (Task, AgentKind)> {
    let kinds = AgentKind::ALL.into_iter().filter(|kind| *kind != AgentKind::Expert);
    kinds.flat_map(|kind| Task::ALL.map(|task| (task, kind)))
}

#[test]
fn expert_succeeds() {
    for task in Task::ALL {
        let succeeded = successes(task, "expert", 300);
        assert!(succeeded >= 297, "{task}: {succeeded} of 300");
    }
}

#[test]
fn expert_takes_20_to_35_steps() {
    for task in Task::ALL {
        let steps: usize = (0..100).map(|seed| play(task, "expert", seed).0.len()).sum();
        assert!((2000..3500).contains(&steps), "{task}: {steps} steps in 100 attempts");
    }
}

#[test]
fn success_falls_with_the_grade() {
    for (task, kind) in imperfect() {
        let at = |grade: &str| successes(task, &format!("{kind}:{grade}"), 60);
        let [good, middling, worst] = [at("0.3"), at("0.5"), at("1")];
        assert!(good > middling && middling > worst, "{task} {kind}: {good}, {middling}, {worst} of 60");
        assert!(worst <= 6, "{task} {kind}: {worst} of 60 succeed at grade 1");
        assert_eq!(successes(task, &format!("{kind}:0"), 20), 20, "{task} {kind}");
    }
}

#[test]
fn actions_before_the_mark_equal_the_experts() {
    for ((task, kind), seed) in imperfect().flat_map(|it| (0..30).map(move |seed| (it, seed))) {
        let (expert, _) = play(task, "expert", seed);
        let (actions, ending) = play(task, &format!("{kind}:1"), seed);
        let mark = ending.went_wrong.unwrap() as usize;
        assert_eq!(actions[..mark], expert[..mark], "{task} {kind}, seed {seed}");
        // A finished expert does nothing, so further motion is a departure too.
        assert_ne!(actions.get(mark), expert.get(mark), "{task} {kind}, seed {seed}");
        let departure = &ending.departure;
        assert_eq!(departure.len(), actions.len());
        assert!(departure[..mark].iter().all(|&by| by == 0.0) && departure[mark] > 0.0, "{task} {kind}, seed {seed}");
        assert!(departure.iter().all(|by| (0.0..=2.0).contains(by)));
    }
}

#[test]
fn departure_is_from_the_experts_action_in_the_same_state() {
    // Grasps the cube 1 cm beside its centre, which holds it, so both agents carry it.
    let (_, ending) = play(Task::PickCube, "missed_grasp:0.3", 0);
    assert!(ending.success && ending.went_wrong.is_some());
    assert!(ending.departure.iter().any(|&by| by > 0.0));
    assert!(*ending.departure.last().unwrap() < 0.3, "{:?}", ending.departure);
    // Opens its fingers while the expert's stay closed.
    let (_, ending) = play(Task::StackCube, "early_release:1", 0);
    assert_eq!(ending.departure[ending.went_wrong.unwrap() as usize], 2.0);
}

#[test]
fn marks_differ_between_attempts() {
    for (task, kind) in imperfect() {
        let marks: std::collections::BTreeSet<_> =
            (0..40).filter_map(|seed| play(task, &format!("{kind}:1"), seed).1.went_wrong).collect();
        assert!(marks.len() >= 4, "{task} {kind}: {marks:?}");
    }
}

#[test]
fn false_start_comes_before_the_script_and_its_fault() {
    for ((task, kind), seed) in imperfect().flat_map(|it| (0..30).map(move |seed| (it, seed))) {
        let (plain, _) = play(task, &format!("{kind}:1"), seed);
        let (actions, ending) = play(task, &format!("{kind}:1+false_start"), seed);
        let (begin, mark) = (ending.went_right.unwrap() as usize, ending.went_wrong.unwrap() as usize);
        assert!((8..=20).contains(&begin) && begin <= mark, "{task} {kind}, seed {seed}: {begin}, {mark}");
        let departure = &ending.departure;
        assert!(departure[..begin].iter().all(|&by| by > 0.0), "{task} {kind}, seed {seed}: {departure:?}");
        assert!(departure[begin..mark].iter().all(|&by| by == 0.0) && departure[mark] > 0.0);
        assert_ne!(actions[0], plain[0]);
        // The gripper follows the script.
        assert_eq!(actions[0][6], plain[0][6]);
    }
}

#[test]
fn expert_recovers_from_a_false_start_and_a_fault_does_not() {
    for task in Task::ALL {
        let succeeded = successes(task, "expert+false_start", 100);
        assert!(succeeded >= 95, "{task}: {succeeded} of 100");
        let (_, ending) = play(task, "expert+false_start", 0);
        assert_eq!((ending.went_right.is_some(), ending.went_wrong), (true, None));
    }
    for (task, kind) in imperfect() {
        let succeeded = successes(task, &format!("{kind}:1+false_start"), 60);
        assert!(succeeded <= 6, "{task} {kind}: {succeeded} of 60");
    }
}

#[test]
fn expert_has_no_mark() {
    let mut demonstration = short("expert");
    assert_eq!(demonstration.went_wrong, None);
    assert!(demonstration.mark().iter().all(|wrong| !wrong));
    demonstration.went_wrong = Some(2);
    assert_eq!(demonstration.mark()[..4], [false, false, true, true]);
    demonstration.went_right = Some(1);
    assert_eq!(demonstration.mark()[..4], [true, false, true, true]);
    assert_eq!(demonstration.mark().len(), demonstration.steps());
}

fn short(agent: &str) -> Demonstration {
    short_at(Task::PickCube, agent)
}

fn short_at(task: Task, agent: &str) -> Demonstration {
    let config = SimConfig { image: 16, ..SimConfig::default() };
    demonstrate(task, config, agent.parse().unwrap(), 11)
}

#[test]
fn same_seed_gives_the_same_bytes() {
    let write = |agent| short(agent).write_mcap(Cursor::new(Vec::new())).unwrap().into_inner();
    assert_eq!(write("noise:0.7"), write("noise:0.7"));
    assert_ne!(write("noise:0.7"), write("noise:0.6"));
}

#[test]
fn recording_reads_back_step_by_step() {
    for task in Task::ALL {
        reads_back(&short_at(task, "expert"));
    }
}

fn reads_back(demonstration: &Demonstration) {
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

/// Depths are equal; colors are compressed as JPEG.
fn same_pictures(read: &[u8], written: &[u8], pixels: usize) {
    assert_eq!(read.len(), written.len());
    for (read, written) in read.chunks(pixels * 5).zip(written.chunks(pixels * 5)) {
        assert_eq!(read[pixels * 3..], written[pixels * 3..]);
        let colors = read[..pixels * 3].iter().zip(&written[..pixels * 3]);
        let off: u32 = colors.map(|(a, b)| u32::from(a.abs_diff(*b))).sum();
        let mean = f64::from(off) / (pixels * 3) as f64;
        assert!(mean < 8.0, "colors differ by {mean} on average");
    }
}

#[test]
fn metadata_has_agent_seed_outcome_and_mark() {
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
