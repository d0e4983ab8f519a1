//! Tests of the parent module: recordings that are cut and joined again.

use std::collections::BTreeMap;
use std::io::Cursor;

use mcap::records::{MessageHeader, Metadata};

use super::*;
use crate::tests::{fixture, pick_cube};
use crate::write::tests::{START, written, written_arm};
use crate::{read_episode, summarize};

/// A folder of parts in their order.
struct Parts {
    folder: tempfile::TempDir,
    paths: Vec<PathBuf>,
}

impl Parts {
    fn of(parts: &[Vec<u8>]) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let mut paths = Vec::new();
        for (at, bytes) in parts.iter().enumerate() {
            paths.push(folder.path().join(format!("run_{at}.mcap")));
            std::fs::write(&paths[at], bytes).unwrap();
        }
        Self { folder, paths }
    }

    /// The joint recording as a file.
    fn joined(&self) -> (PathBuf, RecordingSummary) {
        let mut bytes = Vec::new();
        let summary = join(&self.paths, &mut bytes).unwrap();
        let path = self.folder.path().join("joined");
        std::fs::write(&path, bytes).unwrap();
        (path, summary)
    }

    /// The name of the part that is refused, and the reason.
    fn refusal(&self) -> (String, String) {
        let error = join(&self.paths, std::io::sink()).unwrap_err();
        let RecordingError::Part { path, problem } = error else { panic!("{error}") };
        (path.file_name().unwrap().to_str().unwrap().to_owned(), problem)
    }
}

/// Cuts a recording before these messages. As a recorder does, each part declares its own channels, as their messages
/// come, so that identifiers differ.
fn cut(whole: &Path, at: &[usize]) -> Vec<Vec<u8>> {
    let (mut messages, mut schemas, mut channels) = (Vec::new(), BTreeMap::new(), BTreeMap::new());
    let mut profile = String::new();
    scan(whole, &Limits::default(), &mut |record| {
        match record {
            Record::Header { profile: found } => profile = found.to_owned(),
            Record::Schema { id, name, encoding, data } => {
                schemas.insert(id, (name.to_owned(), encoding.to_owned(), data.to_vec()));
            }
            Record::Channel { id, schema_id, topic, encoding, metadata } => {
                channels.insert(id, (schema_id, topic.to_owned(), encoding.to_owned(), metadata));
            }
            Record::Message { header, data } => messages.push((header, data.to_vec())),
            Record::Metadata { .. } | Record::Attachment { .. } => {}
        }
        Ok(())
    })
    .unwrap();
    let cuts = [&[0], at, &[messages.len()]].concat();
    let part = |range: &[usize]| {
        let mut writer = mcap::WriteOptions::new().profile(&profile).create(Cursor::new(Vec::new())).unwrap();
        for (header, data) in &messages[range[0]..range[1]] {
            let (schema, topic, encoding, metadata) = &channels[&header.channel_id];
            let schema = schemas
                .get(schema)
                .map_or(0, |(name, encoding, data)| writer.add_schema(name, encoding, data).unwrap());
            let channel_id = writer.add_channel(schema, topic, encoding, metadata).unwrap();
            writer.write_to_known_channel(&MessageHeader { channel_id, ..*header }, data).unwrap();
        }
        writer.finish().unwrap();
        writer.into_inner().into_inner()
    };
    cuts.windows(2).map(part).collect()
}

#[test]
fn a_recording_in_three_parts_has_the_steps_of_the_whole() {
    let spec = pick_cube();
    for name in ["pick_cube_ros2.mcap", "pick_cube_foxglove.mcap"] {
        let whole = fixture(name);
        let expected = read_episode(&whole, &spec).unwrap();
        let messages = usize::try_from(expected.report.messages).unwrap();
        // Not at the limits of steps.
        let parts = Parts::of(&cut(&whole, &[messages / 3 + 1, messages / 2 + 2]));
        let (path, summary) = parts.joined();
        let found = read_episode(&path, &spec).unwrap();
        assert_eq!(found.report, expected.report, "{name}");
        assert_eq!(found.episode.stamps(), expected.episode.stamps());
        assert_eq!(found.episode.proprioception(), expected.episode.proprioception());
        assert_eq!(found.episode.action(), expected.episode.action());
        assert_eq!(found.episode.frames().as_ref(), expected.episode.frames().as_ref());
        assert_eq!(Some(summary), summarize(&path).unwrap(), "the summary is that of the file");
    }
}

#[test]
fn the_same_parts_give_the_same_bytes() {
    let parts = Parts::of(&cut(&fixture("pick_cube_ros2.mcap"), &[20, 40]));
    let bytes = || {
        let mut bytes = Vec::new();
        join(&parts.paths, &mut bytes).unwrap();
        bytes
    };
    let first = bytes();
    assert!((0..8).all(|_| bytes() == first));
}

/// A part with messages on these topics at these times in milliseconds.
fn part(profile: &str, messages: &[(&str, u64)]) -> Vec<u8> {
    let mut writer = mcap::WriteOptions::new().profile(profile).create(Cursor::new(Vec::new())).unwrap();
    for (topic, ms) in messages {
        let channel_id = writer.add_channel(0, topic, "json", &BTreeMap::new()).unwrap();
        let time = ms * 1_000_000;
        let header = MessageHeader { channel_id, sequence: 0, log_time: time, publish_time: time };
        writer.write_to_known_channel(&header, b"{}").unwrap();
    }
    let values = BTreeMap::from([("robot".to_owned(), "arm 3".to_owned())]);
    writer.write_metadata(&Metadata { name: "lab".into(), metadata: values }).unwrap();
    let last = messages.last().map_or(0, |(_, ms)| *ms);
    let values = BTreeMap::from([("until".to_owned(), last.to_string())]);
    writer.write_metadata(&Metadata { name: "part".into(), metadata: values }).unwrap();
    let attachment = Attachment {
        log_time: last,
        create_time: 1,
        name: format!("calibration {last}"),
        media_type: "text/plain".into(),
        data: b"1 0 0 1".as_slice().into(),
    };
    writer.attach(&attachment).unwrap();
    writer.finish().unwrap();
    writer.into_inner().into_inner()
}

#[test]
fn topics_attachments_and_metadata_of_every_part_are_kept() {
    let parts = Parts::of(&[
        part("", &[("/a", 1000), ("/tf_static", 1001), ("/a", 2000)]),
        part("", &[("/late", 2500), ("/a", 3000)]),
        part("", &[("/tf_static", 3001), ("/late", 3500), ("/a", 4000)]),
    ]);
    let (path, summary) = parts.joined();
    let (mut topics, mut metadata, mut attachments, mut times) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let scanned = scan(&path, &Limits::default(), &mut |record| {
        match record {
            Record::Channel { topic, .. } if !topics.contains(&topic.to_owned()) => topics.push(topic.to_owned()),
            Record::Message { header, .. } => times.push(header.log_time / 1_000_000),
            Record::Metadata { name, values } => metadata.push((name.to_owned(), values)),
            Record::Attachment { log_time, name, data, .. } => {
                attachments.push((log_time, name.to_owned(), data.len()))
            }
            Record::Header { .. } | Record::Schema { .. } | Record::Channel { .. } => {}
        }
        Ok(())
    });
    assert_eq!(scanned.unwrap().problems, []);
    assert_eq!(topics, ["/a", "/tf_static", "/late"], "each topic has one channel");
    assert_eq!(times, [1000, 1001, 2000, 2500, 3000, 3001, 3500, 4000]);
    let names: Vec<&str> = metadata.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(names, ["lab", "part", "part", "part"], "equal metadata is kept once");
    assert_eq!(attachments, [2000, 3000, 4000].map(|ms| (ms, format!("calibration {ms}"), 7)));
    assert_eq!((summary.messages, summary.channels, summary.duration_ns), (8, 3, 3_000_000_000));
    assert_eq!(Some(summary), summarize(&path).unwrap());
}

#[test]
fn parts_that_overlap_are_refused_by_name() {
    let [first, second, third] =
        [1000, 4000, 7000].map(|at| part("", &[("/a", at), ("/a", at + 1000), ("/a", at + 2990)]));
    for (parts, refused) in [
        ([&first, &first, &second], "run_1.mcap"),
        ([&second, &first, &third], "run_1.mcap"),
        ([&first, &third, &second], "run_2.mcap"),
        ([&first, &second, &first], "run_2.mcap"),
    ] {
        let (name, problem) = Parts::of(&parts.map(Clone::clone)).refusal();
        assert!(name == refused && problem.contains("overlaps with"), "{name}: {problem}");
    }
    let near = part("", &[("/a", 3900), ("/a", 6000)]);
    assert!(join(&Parts::of(&[first.clone(), near]).paths, std::io::sink()).is_ok(), "threads of one recorder");
    let empty = part("", &[]);
    assert!(join(&Parts::of(&[first, empty, second]).paths, std::io::sink()).is_ok(), "a part may be empty");
}

#[test]
fn damaged_and_foreign_parts_are_refused_by_name() {
    let sound = || [part("ros2", &[("/a", 1000)]), part("ros2", &[("/a", 2000)]), part("ros2", &[("/a", 3000)])];
    let changed = |change: &dyn Fn(&mut Vec<u8>)| {
        let mut parts = sound();
        change(&mut parts[1]);
        Parts::of(&parts)
    };
    for (parts, word) in [
        (changed(&|part| part.truncate(part.len() - 9)), "ends in the middle"),
        (changed(&|bytes| *bytes = part("", &[("/a", 2000)])), "profile"),
        (changed(&|bytes| bytes[120] ^= 1), "damaged MCAP file"),
        (changed(&|bytes| bytes.extend(b"tail")), "follow its closing magic bytes"),
    ] {
        let (name, problem) = parts.refusal();
        assert!(name == "run_1.mcap" && problem.contains(word), "{name}: {problem}");
    }
    let other = changed(&|bytes| *bytes = b"something else".to_vec());
    assert!(
        matches!(join(&other.paths, std::io::sink()), Err(RecordingError::NotMcap { path }) if path == other.paths[1])
    );
    let gone = Parts { paths: vec!["no/such.mcap".into()], ..Parts::of(&[]) };
    assert!(matches!(join(&gone.paths, std::io::sink()), Err(RecordingError::Io { .. })));
    assert!(join(&[], std::io::sink()).is_err());
}

/// Takes this many bytes.
struct Full(usize);

impl Write for Full {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0 = self.0.checked_sub(bytes.len()).ok_or(std::io::ErrorKind::BrokenPipe)?;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

#[test]
fn an_output_that_ends_is_an_error() {
    let parts = Parts::of(&[written(20)]);
    for room in [0, 10, 5000] {
        assert!(matches!(join(&parts.paths, Full(room)), Err(RecordingError::Write(_))), "{room}");
    }
    let (path, _) = parts.joined();
    let reading = read_episode(&path, &written_arm()).unwrap();
    assert_eq!((reading.episode.stamps()[0], reading.episode.steps()), (START, 20));
}
