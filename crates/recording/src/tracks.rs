//! The first pass over a recording: the stamps and numbers of every topic that any mapping names.
//!
//! Images are only stamped here; decoding them waits until it is known which ones a step uses, so memory
//! follows the episode and not the recording. This module does not depend on alignment.

mod field;
mod stamps;

use std::collections::BTreeMap;
use std::path::Path as FilePath;

use crate::channels::Channels;
use crate::container::{Record, Scanned, scan};
use crate::dialect::Decoder;
use crate::error::RecordingError;
use crate::limits::Limits;
use crate::transforms::{self, Tree};
use crate::video::Reel;
use gleaner_core::TaskSpec;
use gleaner_core::{FindingCode, TopicReport};

pub(crate) use field::FieldTrack;

/// Header stamps and log times further apart than this, in nanoseconds, are two different clocks.
pub(crate) const MAX_CLOCK_SKEW: u64 = 1_000_000_000;
/// Most messages of one topic.
pub const MAX_MESSAGES: usize = 10_000_000;

/// The result of the first pass.
#[derive(Debug)]
pub(crate) struct Tracks {
    /// The end of the file and its contradictions.
    pub(crate) scanned: Scanned,
    pub(crate) profile: String,
    /// Every channel of the file, rewound for another pass.
    pub(crate) channels: Channels,
    /// Every topic of the file, by name.
    pub(crate) topics: Vec<TopicReport>,
    /// Channels that were declared after their messages or not at all: the number of such messages, and the topic.
    pub(crate) undeclared: Vec<(u16, u64, Option<String>)>,
    /// The topics that some mapping names and the file has.
    pub(crate) tracks: BTreeMap<String, Track>,
}

/// One topic that some mapping names.
#[derive(Debug, Default)]
pub(crate) struct Track {
    /// The stamps of the messages, in the order of the file.
    pub(crate) stamps: Vec<Stamp>,
    /// One for each field source that reads this topic.
    pub(crate) fields: Vec<FieldTrack>,
    /// The first message or schema that can't be read, and how many there are.
    pub(crate) failure: Option<Failure>,
    /// Which messages have a picture, if the topic is the color of a camera.
    pub(crate) reel: Option<Reel>,
    /// The newest transforms for the fields that are poses from them, by the topic of those that never change.
    trees: BTreeMap<String, Tree>,
}

/// The times at which a message was made and logged, in nanoseconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Stamp {
    pub(crate) header: Option<i64>,
    pub(crate) log: i64,
}

/// The first of several failures alike.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Failure {
    pub(crate) code: FindingCode,
    pub(crate) first: String,
    pub(crate) count: u64,
}

/// Reads the stamps and numbers of a recording. Messages that come before their channel's declaration are read too, as a
/// reader that begins with the summary section does; that takes a second pass over the file.
pub(crate) fn collect(path: &FilePath, spec: &TaskSpec, limits: &Limits) -> Result<Tracks, RecordingError> {
    let mut channels = Channels::new(limits);
    let mut pass = Pass::run(path, spec, limits, &mut channels)?;
    let undeclared = channels.undeclared();
    if undeclared.iter().any(|(_, _, topic)| topic.is_some()) {
        channels.rewind();
        pass = Pass::run(path, spec, limits, &mut channels)?;
    }
    let mut topics = channels.topics().to_vec();
    topics.sort_by(|a, b| a.topic.cmp(&b.topic));
    channels.rewind();
    let Pass { scanned, profile, mut wanted } = pass;
    wanted.retain(|_, track| !track.stamps.is_empty() || track.failure.is_some());
    Ok(Tracks { scanned, profile, channels, topics, undeclared, tracks: wanted })
}

/// One pass over the file.
struct Pass {
    scanned: Scanned,
    profile: String,
    wanted: BTreeMap<String, Track>,
}

impl Pass {
    fn run(path: &FilePath, spec: &TaskSpec, limits: &Limits, channels: &mut Channels) -> Result<Self, RecordingError> {
        let (mut profile, mut wanted, fixed) = (String::new(), wanted_tracks(spec)?, static_topics(spec));
        let scanned = scan(path, limits, &mut |record| match record {
            Record::Message { header, data } => {
                let Some((topic, _, decoder)) = channels.next(header.channel_id) else { return Ok(()) };
                for of in fixed.get(topic).into_iter().flatten() {
                    wanted.get_mut(*of).into_iter().for_each(|track| track.fix(decoder, data, topic));
                }
                match wanted.get_mut(topic) {
                    Some(track) => track.push(decoder, header.log_time, data, topic),
                    None => Ok(()),
                }
            }
            Record::Header { profile: found } => {
                found.clone_into(&mut profile);
                Ok(())
            }
            Record::Attachment { .. } => Ok(()),
            Record::Schema { .. } | Record::Channel { .. } | Record::Metadata { .. } => {
                channels.declare(&record, &|topic| wanted.contains_key(topic) || fixed.contains_key(topic))
            }
        })?;
        for track in wanted.values_mut() {
            track.explain();
            stamps::complete(&mut track.stamps);
        }
        Ok(Self { scanned, profile, wanted })
    }
}

/// An empty track for each topic that a mapping names.
fn wanted_tracks(spec: &TaskSpec) -> Result<BTreeMap<String, Track>, RecordingError> {
    let mut wanted: BTreeMap<String, Track> = BTreeMap::new();
    for (at, mapping) in spec.mappings.iter().enumerate() {
        for topic in mapping.topics(spec) {
            wanted.entry(topic.to_owned()).or_default();
        }
        for camera in &mapping.cameras {
            wanted.entry(camera.color.clone()).or_default().reel = Some(Reel::default());
        }
        for (source_at, source) in mapping.fields.iter().enumerate() {
            let size = spec.field_size(&source.field);
            let field = FieldTrack::new(source, (at, source_at), size)?;
            let track = wanted.entry(source.topic.clone()).or_default();
            if let Some(transform) = &source.transform {
                track.trees.entry(transform.static_topic.clone()).or_default();
            }
            track.fields.push(field);
        }
    }
    Ok(wanted)
}

/// For each topic of transforms that never change, the topics of those that do.
fn static_topics(spec: &TaskSpec) -> BTreeMap<&str, Vec<&str>> {
    let mut found: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    for source in spec.mappings.iter().flat_map(|mapping| &mapping.fields) {
        let Some(transform) = &source.transform else { continue };
        // Of one topic each transform counts once.
        if transform.static_topic.is_empty() || transform.static_topic == source.topic {
            continue;
        }
        let of = found.entry(&transform.static_topic).or_default();
        if !of.contains(&source.topic.as_str()) {
            of.push(&source.topic);
        }
    }
    found
}

impl Track {
    fn push(
        &mut self,
        decoder: &Result<Decoder, String>,
        log_time: u64,
        data: &[u8],
        topic: &str,
    ) -> Result<(), RecordingError> {
        if self.stamps.len() >= MAX_MESSAGES {
            return Err(RecordingError::TooLarge {
                problem: format!("topic {topic} has more than {MAX_MESSAGES} messages; split the recording"),
            });
        }
        let log = i64::try_from(log_time).unwrap_or(i64::MAX);
        let value = match decoder {
            Ok(decoder) => decoder.decode(data).map_err(|problem| (FindingCode::BadMessage, problem)),
            Err(problem) => Err((FindingCode::BadSchema, problem.clone())),
        };
        let at = self.stamps.len();
        if let Some(reel) = &mut self.reel {
            reel.push(value.as_ref().ok());
        }
        match value {
            Ok(value) => {
                let header = if self.trees.is_empty() { value.stamp() } else { transforms::stamp(&value) };
                self.stamps.push(Stamp { header, log });
                let updated = |tree: &mut Tree| tree.update(&value);
                let updated: BTreeMap<_, _> =
                    self.trees.iter_mut().map(|(fixed, tree)| (fixed.as_str(), (updated(tree), &*tree))).collect();
                self.fields.iter_mut().try_for_each(|field| match field.fixed().and_then(|fixed| updated.get(fixed)) {
                    Some((updated, tree)) => field.push_pose(at, tree, updated),
                    None => field.push(at, &value),
                })
            }
            Err((code, problem)) => {
                // The message keeps its place, so that the second pass counts alike.
                self.stamps.push(Stamp { header: None, log });
                Failure::record(&mut self.failure, code, || format!("message {at}: {problem}"));
                Ok(())
            }
        }
    }

    /// Takes transforms that never change, of another topic.
    fn fix(&mut self, decoder: &Result<Decoder, String>, data: &[u8], topic: &str) {
        let Some(tree) = self.trees.get_mut(topic) else { return };
        let value = match decoder {
            Ok(decoder) => decoder.decode(data),
            Err(problem) => Err(problem.clone()),
        };
        if let Err(problem) = value.and_then(|value| tree.update(&value)) {
            tree.leave_out(|| format!("a message of {topic} was left out: {problem}"));
        }
    }

    /// Names what is missing for the poses of which no message has any.
    fn explain(&mut self) {
        for field in &mut self.fields {
            if let Some(tree) = field.fixed().and_then(|fixed| self.trees.get(fixed)) {
                field.explain(tree);
            }
        }
    }
}

impl Failure {
    pub(crate) fn record(slot: &mut Option<Self>, code: FindingCode, first: impl FnOnce() -> String) {
        match slot {
            Some(failure) => failure.count += 1,
            None => *slot = Some(Self { code, first: first(), count: 1 }),
        }
    }
}
