//! Tests of the parent module.

use serde_json::{Value, json};

use super::*;
use crate::read_episode;
use crate::tests::scene::{Scene, numbers_only};

/// A recording of 20 steps at 10 Hz from 1000 ms on, with these events.
fn recorded(events: &[(i64, Value)]) -> (tempfile::TempDir, PathBuf) {
    let mut scene = Scene::steps(20);
    for (ms, content) in events {
        scene.add("/episode", *ms, content.clone());
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("long.mcap");
    std::fs::write(&path, scene.mcap()).unwrap();
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
fn stamps(folder: &Path, CutEpisode { file_name, success }: CutEpisode) -> (i64, i64, Option<bool>) {
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
