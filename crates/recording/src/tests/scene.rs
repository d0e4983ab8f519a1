//! Small recordings in memory, whose messages a test defines.

use std::collections::BTreeMap;
use std::io::Cursor;
use std::path::Path;

use mcap::records::MessageHeader;
use serde_json::{Value, json};

use crate::testing::arm;
use crate::{Finding, FindingCode, Limits, Reading, RecordingError, Report, Severity, TaskSpec, read_episode_within};

/// The small test task without its camera, read from JSON topics.
pub(crate) fn numbers_only() -> TaskSpec {
    let mut spec = arm();
    spec.cameras.clear();
    spec.mappings[0].cameras.clear();
    spec
}

/// Messages of a recording: topic, stamp and log time in milliseconds, content.
#[derive(Clone, Default)]
pub(crate) struct Scene {
    pub(super) messages: Vec<(&'static str, Option<i64>, i64, Value)>,
}

impl Scene {
    /// A number of steps at 10 Hz with equal stamps of all streams and both joints moving.
    pub(crate) fn steps(count: i64) -> Self {
        let mut scene = Self::default();
        for at in 0..count {
            let (ms, value) = (1000 + at * 100, f64::from(i32::try_from(at).unwrap()) * 0.1);
            scene.add("/joints", ms, json!({"position": [value, -value]}));
            scene.add("/tool", ms, json!({"x": value}));
            scene.add("/command", ms, json!({"values": [value, 1.0]}));
        }
        scene
    }

    pub(crate) fn add(&mut self, topic: &'static str, ms: i64, content: Value) {
        self.messages.push((topic, Some(ms), ms, content));
    }

    /// Puts the messages into the order of time.
    pub(crate) fn sort(&mut self) {
        self.messages.sort_by_key(|(_, _, log, _)| *log);
    }

    /// Changes the messages of one topic; those for which `change` gives false are left out.
    pub(super) fn change(mut self, topic: &str, mut change: impl FnMut(usize, &mut i64, &mut Value) -> bool) -> Self {
        let mut at = 0;
        self.messages.retain_mut(|(of, stamp, _, content)| {
            if *of != topic {
                return true;
            }
            at += 1;
            stamp.as_mut().is_none_or(|stamp| change(at - 1, stamp, content))
        });
        self
    }

    /// Without a topic.
    pub(super) fn without(mut self, topic: &str) -> Self {
        self.messages.retain(|(of, ..)| *of != topic);
        self
    }

    /// Changes the content of each message of a topic.
    pub(super) fn change_all(mut self, topic: &str, change: impl Fn(&mut Value)) -> Self {
        self.messages.iter_mut().filter(|(of, ..)| *of == topic).for_each(|(.., content)| change(content));
        self
    }

    pub(crate) fn mcap(&self) -> Vec<u8> {
        self.written(mcap::WriteOptions::new().use_chunks(false))
    }

    /// The recording as a writer with these options leaves it.
    pub(crate) fn written(&self, options: mcap::WriteOptions) -> Vec<u8> {
        let mut writer = options.create(Cursor::new(Vec::new())).unwrap();
        for (topic, stamp, log, content) in &self.messages {
            let channel = writer.add_channel(0, topic, "json", &BTreeMap::new()).unwrap();
            let mut content = content.clone();
            if let (Some(ms), Some(fields)) = (stamp, content.as_object_mut()) {
                fields.insert(
                    "timestamp".into(),
                    json!({"sec": ms.div_euclid(1000), "nsec": ms.rem_euclid(1000) * 1_000_000}),
                );
            }
            let time = u64::try_from(log * 1_000_000).unwrap();
            let header = MessageHeader { channel_id: channel, sequence: 0, log_time: time, publish_time: time };
            writer.write_to_known_channel(&header, content.to_string().as_bytes()).unwrap();
        }
        writer.finish().unwrap();
        writer.into_inner().into_inner()
    }

    pub(super) fn read(&self, spec: &TaskSpec) -> Result<Reading, RecordingError> {
        read_bytes(&self.mcap(), spec)
    }

    /// The report, whether the recording is accepted or not.
    pub(super) fn report(&self, spec: &TaskSpec) -> Report {
        match self.read(spec) {
            Ok(reading) => reading.report,
            Err(RecordingError::Rejected(report)) => *report,
            Err(error) => panic!("{error}"),
        }
    }
}

pub(super) fn read_bytes(bytes: &[u8], spec: &TaskSpec) -> Result<Reading, RecordingError> {
    read_bytes_within(bytes, spec, &Limits::default())
}

pub(super) fn read_bytes_within(bytes: &[u8], spec: &TaskSpec, limits: &Limits) -> Result<Reading, RecordingError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    write(&path, bytes);
    read_episode_within(&path, spec, limits)
}

fn write(path: &Path, bytes: &[u8]) {
    std::fs::write(path, bytes).unwrap();
}

/// The one finding of a report.
pub(super) fn only(report: &Report) -> &Finding {
    assert_eq!(report.findings.len(), 1, "{:?}", report.findings);
    &report.findings[0]
}

/// The one finding of a report, which must be this.
pub(super) fn check(report: &Report, severity: Severity, code: FindingCode, subject: &str) -> Finding {
    let finding = only(report);
    assert_eq!((finding.severity, finding.code, finding.subject.as_str()), (severity, code, subject));
    finding.clone()
}
