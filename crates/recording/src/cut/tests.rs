//! Tests of the parent module.

use mcap::records::op;
use serde_json::{Value, json};

use super::*;
use crate::mutants::{Part, Random, join, mutant, split};
use crate::read_episode;
use crate::tests::scene::{Scene, numbers_only};

/// A recording of 20 steps at 10 Hz from 1000 ms on, with these events.
fn recorded(events: &[(i64, Value)]) -> (tempfile::TempDir, PathBuf) {
    stored(&scene(events).mcap())
}

fn scene(events: &[(i64, Value)]) -> Scene {
    let mut scene = Scene::steps(20);
    for (ms, content) in events {
        scene.add("/episode", *ms, content.clone());
    }
    scene
}

fn stored(bytes: &[u8]) -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("long.mcap");
    std::fs::write(&path, bytes).unwrap();
    (folder, path)
}

/// Stamps of the first and last step in milliseconds, and the outcome, of each episode.
fn episodes(events: &[(i64, Value)]) -> Vec<(i64, i64, Option<bool>)> {
    let (folder, path) = recorded(events);
    let out = folder.path().join("out");
    std::fs::create_dir(&out).unwrap();
    let cut = cut(&path, Cuts::Topic("/episode"), &Limits::default(), &out).unwrap();
    cut.into_iter().map(|episode| stamps(&out, episode)).collect()
}

/// Stamps of the first and last step in milliseconds, and the outcome, of one episode.
fn stamps(folder: &Path, CutEpisode { file_name, success, .. }: CutEpisode) -> (i64, i64, Option<bool>) {
    let stamps = read_episode(&folder.join(file_name), &numbers_only()).unwrap().episode.stamps().to_vec();
    (stamps[0] / 1_000_000, stamps.last().unwrap() / 1_000_000, success)
}

#[test]
fn ranges_of_time_are_episodes_in_their_order() {
    let (folder, path) = recorded(&[]);
    let range = |start_s, end_s, success| TimeRange { start_s, end_s, success };
    let ranges = [range(1.2, 1.9, Some(false)), range(0.25, 1.0, None), range(1.0, 1.2, Some(true))];
    let cut = cut(&path, Cuts::Ranges(&ranges), &Limits::default(), folder.path()).unwrap();
    let found: Vec<_> = cut.into_iter().map(|episode| stamps(folder.path(), episode)).collect();
    assert_eq!(found, [(1300, 1900, None), (2000, 2100, Some(true)), (2200, 2900, Some(false))]);
    let late = [range(5.0, 6.0, None)];
    let refused = super::cut(&path, Cuts::Ranges(&late), &Limits::default(), folder.path()).unwrap_err().to_string();
    assert!(refused.contains("5 to 6 s is outside of the recording") && refused.contains("1.90 s"), "{refused}");
}

#[test]
fn each_message_of_the_topic_begins_an_episode() {
    let marks = [(1250, json!({"by": 1, "of": 2})), (2050, json!({"by": 1, "of": 2}))];
    assert_eq!(episodes(&marks), [(1300, 2000, None), (2100, 2900, None)]);
    let numbers = [(1000, json!({"data": 0})), (1500, json!({"data": 1})), (2400, json!({"data": 2}))];
    assert_eq!(episodes(&numbers), [(1000, 1400, None), (1500, 2300, None), (2400, 2900, None)]);
}

#[test]
fn words_and_flags_end_episodes_with_their_outcome() {
    let words = [
        (1100, json!({"data": "start"})),
        (1500, json!({"data": "success"})),
        (1600, json!({"data": "start"})),
        (1800, json!({"data": "discard"})),
        (1900, json!({"data": "start"})),
        (2300, json!({"data": "failure"})),
    ];
    assert_eq!(episodes(&words), [(1100, 1400, Some(true)), (1900, 2200, Some(false))]);
    let flags = [(1200, json!({"data": true})), (1700, json!({"data": false}))];
    assert_eq!(episodes(&flags), [(1200, 1600, None)]);
}

#[test]
fn the_same_recording_gives_the_same_bytes() {
    let (folder, path) = recorded(&[(1500, json!({"data": "start"}))]);
    let mut found = Vec::new();
    for name in ["one", "two"] {
        let out = folder.path().join(name);
        std::fs::create_dir(&out).unwrap();
        let cut = cut(&path, Cuts::Topic("/episode"), &Limits::default(), &out).unwrap();
        found.push(std::fs::read(out.join(&cut[0].file_name)).unwrap());
    }
    assert!(found[0] == found[1]);
}

#[test]
fn a_topic_without_events_is_refused_with_those_there_are() {
    let (folder, path) = recorded(&[(1500, json!({"data": "stop"}))]);
    let refused =
        |topic: &str| cut(&path, Cuts::Topic(topic), &Limits::default(), folder.path()).unwrap_err().to_string();
    let error = refused("/marker");
    assert!(error.contains("/marker") && error.contains("/joints") && error.contains("/episode"), "{error}");
    assert!(refused("/episode").contains("none begins one"));
    let damaged = folder.path().join("damaged.mcap");
    std::fs::write(&damaged, b"no recording").unwrap();
    assert!(cut(&damaged, Cuts::Topic("/episode"), &Limits::default(), folder.path()).is_err());
}

/// A recording in small chunks with a successful episode and a second one, in the order of time.
fn two_episodes() -> Vec<u8> {
    let mut scene = scene(&[
        (1100, json!({"data": "start"})),
        (1500, json!({"data": "success"})),
        (1600, json!({"data": "start"})),
    ]);
    scene.sort();
    scene.written(mcap::WriteOptions::new().chunk_size(Some(600)).compression(None))
}

#[test]
fn a_recording_without_its_end_gives_the_episodes_before_it() {
    let bytes = two_episodes();
    let mut left_out = 0;
    for end in (bytes.len() / 2..bytes.len()).step_by(7) {
        let (folder, path) = stored(&bytes[..end]);
        let Ok(cut) = cut(&path, Cuts::Topic("/episode"), &Limits::default(), folder.path()) else {
            panic!("cut at {end}")
        };
        let [whole, last] = <[CutEpisode; 2]>::try_from(cut).unwrap_or_else(|cut| panic!("cut at {end}: {cut:?}"));
        assert_eq!(stamps(folder.path(), whole), (1100, 1400, Some(true)), "cut at {end}");
        let reason = last.left_out.unwrap();
        assert!(reason.contains("ends in the middle of it") && reason.contains(" s or before"), "{reason}");
        assert!(!folder.path().join(last.file_name).exists(), "cut at {end}");
        left_out += 1;
    }
    assert!(left_out > 100, "{left_out}");
}

#[test]
fn an_episode_that_ended_before_the_missing_end_is_whole() {
    let mut scene = scene(&[(1100, json!({"data": "start"})), (1500, json!({"data": "failed"}))]);
    scene.sort();
    let bytes = scene.mcap();
    let (folder, path) = stored(&bytes[..bytes.len() - 400]);
    let found = cut(&path, Cuts::Topic("/episode"), &Limits::default(), folder.path()).unwrap();
    assert_eq!((found.len(), &found[0].left_out, found[0].success), (1, &None, Some(false)));
}

#[test]
fn a_range_to_the_missing_end_is_left_out_and_the_stated_time_gives_it() {
    let mut scene = scene(&[]);
    scene.sort();
    let bytes = scene.mcap();
    let (folder, path) = stored(&bytes[..bytes.len() - 10]);
    let range = |start_s, end_s| TimeRange { start_s, end_s, success: None };
    let cut = |ranges: &[TimeRange]| cut(&path, Cuts::Ranges(ranges), &Limits::default(), folder.path()).unwrap();
    let found = cut(&[range(1.0, 1.9), range(0.0, 0.5)]);
    assert_eq!(found[0].left_out, None);
    let reason = found[1].left_out.clone().unwrap();
    assert!(reason.ends_with("a range of time that ends at 1.88 s or before"), "{reason}");
    assert_eq!(cut(&[range(1.0, 1.88)])[0].left_out, None);
}

#[test]
fn a_recording_with_lost_parts_is_refused() {
    let bytes = two_episodes();
    let refused = |bytes: &[u8]| {
        let (folder, path) = stored(bytes);
        let ranges = [TimeRange { start_s: 0.0, end_s: 0.5, success: None }];
        [Cuts::Topic("/episode"), Cuts::Ranges(&ranges)].map(|cuts| {
            let error = cut(&path, cuts, &Limits::default(), folder.path()).unwrap_err();
            assert!(matches!(error, RecordingError::Damaged { .. }), "{error}");
            error.to_string()
        })
    };
    for lost in refused(&mutant(&bytes, "drop_last_chunk", &mut Random::new(0)).unwrap()) {
        assert!(lost.contains("mcap recover"), "{lost}");
    }
    // A message of a channel that is never declared.
    let mut parts = unchecked(&Scene::steps(10).mcap());
    parts.retain(|part| !matches!(part.opcode, op::STATISTICS | op::SUMMARY_OFFSET));
    let message = parts.iter().position(|part| part.opcode == op::MESSAGE).unwrap();
    let body = [&77_u16.to_le_bytes()[..], &parts[message].body[2..]].concat();
    parts.insert(message, Part { opcode: op::MESSAGE, body });
    for undeclared in refused(&truncated(&parts)) {
        assert!(undeclared.contains("no record declares channel 77"), "{undeclared}");
    }
}

/// The records of a recording without a checksum of its data.
fn unchecked(bytes: &[u8]) -> Vec<Part> {
    let mut parts = split(bytes);
    let end = parts.iter_mut().find(|part| part.opcode == op::DATA_END).unwrap();
    end.body = vec![0; 4];
    parts
}

/// These records up to the end of the data, without a summary.
fn truncated(parts: &[Part]) -> Vec<u8> {
    let end = parts.iter().position(|part| part.opcode == op::DATA_END).unwrap();
    let bytes = join(&parts[..=end]);
    bytes[..bytes.len() - mcap::MAGIC.len()].to_vec()
}

#[test]
fn messages_before_their_declaration_are_in_the_episodes_and_mark_them() {
    let mut scene = scene(&[
        (1100, json!({"data": "start"})),
        (1400, json!({"data": "success"})),
        (1500, json!({"data": "start"})),
        (1900, json!({"data": "failure"})),
    ]);
    scene.sort();
    let mut parts = unchecked(&scene.mcap());
    // Every declaration of the data section lies behind its messages, as after two chunks are swapped.
    let end = parts.iter().position(|part| part.opcode == op::DATA_END).unwrap();
    let (mut data, rest) = (parts[..end].to_vec(), parts.split_off(end));
    data.sort_by_key(|part| part.opcode == op::CHANNEL);
    let (folder, path) = stored(&join(&[data, rest].concat()));
    let cut = cut(&path, Cuts::Topic("/episode"), &Limits::default(), folder.path()).unwrap();
    let found: Vec<_> = cut.into_iter().map(|episode| stamps(folder.path(), episode)).collect();
    assert_eq!(found, [(1100, 1300, Some(true)), (1500, 1800, Some(false))]);
}
