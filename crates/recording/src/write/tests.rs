//! Tests of the parent module.

use std::io::Cursor;

use super::*;
use crate::read::read_episode;
use crate::testing::arm;
use crate::tests::video::{self, Film};

/// Name and descriptors of the small test task's state message.
pub(crate) fn state_schema() -> (String, Vec<u8>) {
    let schema = schema::numbers("State", &arm().proprioception);
    (schema.name, schema.descriptors)
}

/// The small test task with the writer's mapping alone.
pub(crate) fn written_arm() -> TaskSpec {
    let mut spec = arm();
    spec.mappings = vec![written_mapping(&spec)];
    spec
}

pub(crate) const START: i64 = 1_700_000_000_000_000_000;

/// Numbers and frames of a step, different for each.
pub(crate) fn step_data(spec: &TaskSpec, step: u8) -> (Vec<u8>, Vec<f32>, Vec<f32>) {
    let s = f32::from(step);
    let camera = &spec.cameras[0];
    let pixels = Channel::Depth.bytes(camera) / 2;
    let color = [100 + step, 50, 200 - step].repeat(pixels);
    let depth = (0..pixels).flat_map(|at| u16::try_from(at * 7 + usize::from(step)).unwrap().to_le_bytes());
    let frames = color.into_iter().chain(depth).collect();
    (frames, vec![0.1 * s, -0.2 * s, 0.3], vec![s, 1.0 / (s + 3.0)])
}

/// A recording in memory with this number of steps at 10 Hz.
pub(crate) fn written(steps: u8) -> Vec<u8> {
    let spec = written_arm();
    let mut writer = EpisodeWriter::create(Cursor::new(Vec::new()), &spec).unwrap();
    for at in 0..steps {
        let (frames, proprioception, action) = step_data(&spec, at);
        let step = StepRef { frames: &frames, proprioception: &proprioception, action: &action };
        writer.step(START + i64::from(at) * 100_000_000, step).unwrap();
    }
    writer.annotate("/note", START, &serde_json::json!({"by": "hand"})).unwrap();
    writer.metadata("session", BTreeMap::from([("outcome".into(), "success".into())])).unwrap();
    writer.finish().unwrap().into_inner()
}

#[test]
fn written_steps_read_back() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    std::fs::write(&path, written(5)).unwrap();
    let spec = written_arm();
    let reading = read_episode(&path, &spec).unwrap();
    assert_eq!(reading.mapping, "gleaner");
    assert!(reading.report.findings.is_empty(), "{:?}", reading.report.findings);
    assert_eq!(reading.episode.stamps(), [0, 1, 2, 3, 4].map(|at| START + at * 100_000_000));
    let frames = reading.episode.frames();
    for step in 0..5u8 {
        let (expected, proprioception, action) = step_data(&spec, step);
        let at = usize::from(step);
        assert_eq!(reading.episode.proprioception()[at * 3..at * 3 + 3], proprioception);
        assert_eq!(reading.episode.action()[at * 2..at * 2 + 2], action);
        let found = &frames.as_ref()[at * expected.len()..(at + 1) * expected.len()];
        let color = Channel::Color.bytes(&spec.cameras[0]);
        assert_eq!(found[color..], expected[color..], "depth of step {step}");
        let worst = found[..color].iter().zip(&expected).map(|(a, b)| a.abs_diff(*b)).max().unwrap();
        assert!(worst <= 3, "color of step {step} is off by {worst}");
    }
    let note = reading.report.topics.iter().find(|topic| topic.topic == "/note").unwrap();
    assert!(!note.used && note.messages == 1);
}

#[test]
fn a_step_that_does_not_fit_is_refused_by_name() {
    let spec = written_arm();
    let mut writer = EpisodeWriter::create(Cursor::new(Vec::new()), &spec).unwrap();
    let (frames, proprioception, action) = step_data(&spec, 0);
    let step = StepRef { frames: &frames, proprioception: &proprioception, action: &action };
    let mut problem = |stamp, step| writer.step(stamp, step).unwrap_err().to_string();
    assert!(problem(START, StepRef { frames: &[], ..step }).contains("frames"));
    assert!(problem(START, StepRef { proprioception: &[0.0], ..step }).contains("proprioception"));
    assert!(problem(START, StepRef { action: &[0.0], ..step }).contains("action"));
    assert!(problem(-1, step).contains("-1"));
    assert!(writer.annotate(STATE_TOPIC, START, &serde_json::Value::Null).is_err());
}

/// Video in protobuf: a schema with the fields of foxglove.CompressedVideo.
#[test]
fn video_in_protobuf_is_read() {
    let film = Film::read("h264_baseline");
    let mut spec = video::task();
    spec.mappings = vec![written_mapping(&spec)];
    let mut writer = EpisodeWriter::create(Cursor::new(Vec::new()), &spec).unwrap();
    for (stamp, data) in (START..).step_by(100_000_000).zip(&film.messages) {
        writer.image(0, Channel::Color, stamp, images::Kept::Compressed("h264", data)).unwrap();
        writer.state(stamp, &[0.5; 3]).unwrap();
        writer.action(stamp, &[0.25; 2]).unwrap();
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    std::fs::write(&path, writer.finish().unwrap().into_inner()).unwrap();
    let reading = read_episode(&path, &spec).unwrap();
    assert!(video::frames(&reading) == film.pictures());
}
