//! From tracks to steps: which mapping fits, which messages make up each step, and the steps' numbers.
//!
//! Everything of an episode but its pixels. Findings about the data are made in `inspect`.

use std::collections::BTreeMap;
use std::path::Path;

use crate::align::{Rule, Timeline};
use crate::container::Ending;
use crate::error::RecordingError;
use crate::inspect;
use crate::picture::Channel;
use crate::report::{FindingCode, Report, Severity};
use crate::spec::{FieldSpec, Mapping, TaskSpec};
use crate::tracks::{FieldTrack, Stamp, Tracks, collect};

/// Header stamps and log times further apart than this, in nanoseconds, are two different clocks.
const MAX_CLOCK_SKEW: i64 = 1_000_000_000;

/// The steps of one recording.
#[derive(Debug)]
pub(crate) struct Plan {
    /// Index of the mapping that fits.
    pub(crate) mapping: usize,
    pub(crate) profile: String,
    pub(crate) clock_topic: String,
    /// The clock's message of each step, by its index in the topic.
    pub(crate) clock: Vec<usize>,
    /// Log time of the clock's message of each step.
    pub(crate) log_times: Vec<i64>,
    pub(crate) stamps: Vec<i64>,
    pub(crate) images: Vec<ImageStream>,
    /// For each topic, the messages that the steps use, by their index in the topic: one row a stream.
    pub(crate) used: BTreeMap<String, Vec<Vec<usize>>>,
    /// T×M, row-major.
    pub(crate) proprioception: Vec<f32>,
    /// T×A, row-major.
    pub(crate) action: Vec<f32>,
    pub(crate) report: Report,
}

/// One topic of images.
#[derive(Debug)]
pub(crate) struct ImageStream {
    pub(crate) topic: String,
    /// Index of the camera in the task.
    pub(crate) camera: usize,
    pub(crate) channel: Channel,
    /// The message of each step, by its index in the topic.
    pub(crate) picks: Vec<usize>,
}

/// A stream before it is known which steps there are.
pub(crate) struct Stream {
    /// Topic or field, for findings.
    pub(crate) subject: String,
    pub(crate) topic: String,
    pub(crate) timeline: Timeline,
}

/// Works the steps of a recording out.
///
/// # Errors
/// [`RecordingError::Rejected`] when no step can be made; findings that leave steps are in the report.
pub(crate) fn plan(path: &Path, spec: &TaskSpec) -> Result<Plan, RecordingError> {
    if spec.mappings.is_empty() {
        let problem =
            "the task has none; add one that says where its cameras and fields are in a recording";
        return Err(RecordingError::Spec {
            field: "mappings".into(),
            problem: problem.into(),
        });
    }
    let tracks = collect(path, spec)?;
    let mut report = begin_report(&tracks);
    let at = choose_mapping(&tracks, spec, &mut report)?;
    let mapping = &spec.mappings[at];
    for topic in mapping.topics(spec) {
        report
            .topics
            .iter_mut()
            .filter(|entry| entry.topic == topic)
            .for_each(|entry| entry.used = true);
    }
    inspect::failures(&tracks, spec, at, &mut report);
    let clocks = Clocks::new(&tracks, mapping, spec, &mut report);
    let images = image_streams(&tracks, mapping, spec, &clocks);
    let fields = field_streams(&tracks, at, spec, &clocks);
    let Some(fields) = fields.filter(|_| !report.has_errors()) else {
        return Err(RecordingError::Rejected(Box::new(report.sorted())));
    };
    let clock_topic = mapping.clock_topic(spec).unwrap_or_default().to_owned();
    let clock = clocks.timeline(&tracks, &clock_topic);
    let steps = Steps::new(
        spec,
        clock,
        images
            .iter()
            .map(|(stream, ..)| stream)
            .chain(fields.iter().map(|(stream, _)| stream)),
    );
    inspect::steps(&steps, spec, &mut report);
    let (image_picks, field_picks) = steps.picks.split_at(images.len());
    let clock: Vec<usize> = steps
        .ticks
        .iter()
        .map(|&at| steps.clock.order[at])
        .collect();
    let mut plan = Plan {
        mapping: at,
        profile: tracks.profile.clone(),
        log_times: clock
            .iter()
            .map(|&message| tracks.tracks[&clock_topic].stamps[message].log)
            .collect(),
        clock,
        clock_topic,
        stamps: steps.stamps.clone(),
        images: Vec::new(),
        used: BTreeMap::new(),
        proprioception: gather(
            &spec.proprioception,
            &fields,
            field_picks,
            steps.ticks.len(),
        ),
        action: gather(&spec.action, &fields, field_picks, steps.ticks.len()),
        report,
    };
    plan.used
        .entry(plan.clock_topic.clone())
        .or_default()
        .push(plan.clock.clone());
    for ((stream, camera, channel), picks) in images.into_iter().zip(image_picks) {
        let picks: Vec<usize> = picks.iter().map(|&at| stream.timeline.order[at]).collect();
        plan.used
            .entry(stream.topic.clone())
            .or_default()
            .push(picks.clone());
        plan.images.push(ImageStream {
            topic: stream.topic,
            camera,
            channel,
            picks,
        });
    }
    for ((stream, track), picks) in fields.iter().zip(field_picks) {
        let messages = picks
            .iter()
            .map(|&at| track.messages[stream.timeline.order[at]])
            .collect();
        plan.used
            .entry(stream.topic.clone())
            .or_default()
            .push(messages);
    }
    inspect::values(&plan.proprioception, &spec.proprioception, &mut plan.report);
    inspect::values(&plan.action, &spec.action, &mut plan.report);
    inspect::frozen_joints(&plan.proprioception, &spec.proprioception, &mut plan.report);
    Ok(plan)
}

fn begin_report(tracks: &Tracks) -> Report {
    let mut report = Report {
        messages: tracks.messages,
        topics: tracks.topics.values().cloned().collect(),
        ..Report::default()
    };
    if tracks.ending == Some(Ending::Cut) {
        let detail = format!(
            "the file ends in the middle; the {} whole messages before the cut were read. Let the recorder close its \
             files to get all of them",
            tracks.messages
        );
        report.add(
            Severity::Warning,
            FindingCode::Truncated,
            "file",
            None,
            detail,
        );
    }
    report
}

/// The mapping with the most topics among those of which all are there.
fn choose_mapping(
    tracks: &Tracks,
    spec: &TaskSpec,
    report: &mut Report,
) -> Result<usize, RecordingError> {
    let missing = |mapping: &Mapping| -> Vec<String> {
        let topics = mapping.topics(spec);
        topics
            .iter()
            .filter(|&&topic| !tracks.tracks.contains_key(topic))
            .map(|&topic| topic.to_owned())
            .collect()
    };
    let score = |mapping: &Mapping| {
        (
            missing(mapping).len(),
            usize::MAX - mapping.topics(spec).len(),
        )
    };
    let Some((at, mapping)) = spec
        .mappings
        .iter()
        .enumerate()
        .min_by_key(|(_, mapping)| score(mapping))
    else {
        return Ok(0);
    };
    report.mapping.clone_from(&mapping.name);
    let missing = missing(mapping);
    if missing.is_empty() {
        return Ok(at);
    }
    for topic in missing {
        let detail = format!(
            "mapping `{}` is the nearest but its topic {topic} has no messages in the file; record it, or add a mapping \
             for the topics that are there",
            mapping.name
        );
        report.add(
            Severity::Error,
            FindingCode::MissingTopic,
            &topic,
            None,
            detail,
        );
    }
    Err(RecordingError::Rejected(Box::new(
        std::mem::take(report).sorted(),
    )))
}

/// Which of a message's two times counts.
struct Clocks {
    log_only: bool,
}

impl Clocks {
    /// Header stamps first. Only when some topic has none, and the others' are of another clock than the
    /// recorder's, is the one clock that all share used: log time.
    fn new(tracks: &Tracks, mapping: &Mapping, spec: &TaskSpec, report: &mut Report) -> Self {
        let topics = mapping.topics(spec);
        let stamps = |topic: &str| {
            tracks
                .tracks
                .get(topic)
                .map(|track| track.stamps.as_slice())
                .unwrap_or_default()
        };
        let headless = topics
            .iter()
            .find(|&&topic| stamps(topic).iter().all(|stamp| stamp.header.is_none()));
        let skewed = topics.iter().find(|&&topic| {
            let mut skews: Vec<u64> = stamps(topic)
                .iter()
                .filter_map(|stamp| Some(stamp.header?.abs_diff(stamp.log)))
                .collect();
            skews.sort_unstable();
            skews
                .get(skews.len() / 2)
                .is_some_and(|&skew| skew > MAX_CLOCK_SKEW.unsigned_abs())
        });
        let log_only = match (headless, skewed) {
            (Some(headless), Some(skewed)) => {
                let detail = format!(
                    "its header stamps are of another clock than the recorder's, and {headless} has none, so log times \
                     were used for all; stamp {headless} to align better"
                );
                report.add(
                    Severity::Note,
                    FindingCode::MixedClocks,
                    skewed,
                    None,
                    detail,
                );
                true
            }
            _ => false,
        };
        Self { log_only }
    }

    fn time(&self, stamp: Stamp) -> i64 {
        stamp.header.filter(|_| !self.log_only).unwrap_or(stamp.log)
    }

    fn timeline(&self, tracks: &Tracks, topic: &str) -> Timeline {
        let stamps = tracks
            .tracks
            .get(topic)
            .map(|track| track.stamps.as_slice())
            .unwrap_or_default();
        Timeline::new(stamps.iter().map(|&stamp| self.time(stamp)))
    }
}

fn image_streams(
    tracks: &Tracks,
    mapping: &Mapping,
    spec: &TaskSpec,
    clocks: &Clocks,
) -> Vec<(Stream, usize, Channel)> {
    let mut streams = Vec::new();
    for (at, camera) in spec.cameras.iter().enumerate() {
        let source = mapping
            .cameras
            .iter()
            .find(|source| source.camera == camera.name);
        let topics = source.map(|source| {
            [
                (Some(&source.color), Channel::Color),
                (source.depth.as_ref(), Channel::Depth),
            ]
        });
        for (topic, channel) in topics.into_iter().flatten() {
            let Some(topic) = topic else { continue };
            let stream = Stream {
                subject: topic.clone(),
                topic: topic.clone(),
                timeline: clocks.timeline(tracks, topic),
            };
            streams.push((stream, at, channel));
        }
    }
    streams
}

/// One stream a field, in the order of proprioception, then action; `None` when one has no values.
fn field_streams<'a>(
    tracks: &'a Tracks,
    mapping: usize,
    spec: &TaskSpec,
    clocks: &Clocks,
) -> Option<Vec<(Stream, &'a FieldTrack)>> {
    let sources = &spec.mappings[mapping].fields;
    let all = spec.proprioception.iter().chain(&spec.action);
    all.map(|field| {
        let at = sources
            .iter()
            .position(|source| source.field == field.name)?;
        let topic = &sources[at].topic;
        let track = tracks.tracks.get(topic)?;
        let values = track
            .fields
            .iter()
            .find(|values| (values.mapping, values.source) == (mapping, at))?;
        let timeline = Timeline::new(
            values
                .messages
                .iter()
                .map(|&message| clocks.time(track.stamps[message])),
        );
        let stream = Stream {
            subject: field.name.clone(),
            topic: topic.clone(),
            timeline,
        };
        (!values.messages.is_empty()).then_some((stream, values))
    })
    .collect()
}

/// The steps: the clock's ticks from the first at which every stream has begun.
pub(crate) struct Steps {
    pub(crate) clock: Timeline,
    /// Positions in the clock.
    pub(crate) ticks: Vec<usize>,
    pub(crate) stamps: Vec<i64>,
    pub(crate) rule: Rule,
    /// Subject and timeline of each stream.
    pub(crate) streams: Vec<(String, Timeline)>,
    /// For each stream, the position in its timeline that each step picks.
    pub(crate) picks: Vec<Vec<usize>>,
}

impl Steps {
    fn new<'a>(
        spec: &TaskSpec,
        clock: Timeline,
        streams: impl Iterator<Item = &'a Stream>,
    ) -> Self {
        let rule = Rule::new(spec);
        let streams: Vec<(String, Timeline)> = streams
            .map(|stream| (stream.subject.clone(), stream.timeline.clone()))
            .collect();
        let mut ticks = clock.ticks(rule);
        let begun = |tick: &usize| {
            streams
                .iter()
                .all(|(_, line)| rule.pick(line, clock.stamps[*tick]).is_some())
        };
        let first = ticks.iter().position(begun).unwrap_or(ticks.len());
        ticks.drain(..first);
        let stamps: Vec<i64> = ticks.iter().map(|&tick| clock.stamps[tick]).collect();
        let picks = streams.iter().map(|(_, line)| {
            stamps
                .iter()
                .filter_map(|&stamp| rule.pick(line, stamp))
                .collect()
        });
        let picks = picks.collect();
        Self {
            clock,
            ticks,
            stamps,
            rule,
            streams,
            picks,
        }
    }
}

/// The fields' values of each step, one field after the other.
fn gather(
    fields: &[FieldSpec],
    streams: &[(Stream, &FieldTrack)],
    picks: &[Vec<usize>],
    steps: usize,
) -> Vec<f32> {
    let mut out = Vec::with_capacity(
        steps
            * fields
                .iter()
                .map(|field| field.size as usize)
                .sum::<usize>(),
    );
    let rows: Vec<_> = fields
        .iter()
        .filter_map(|field| {
            streams
                .iter()
                .zip(picks)
                .find(|((stream, _), _)| stream.subject == field.name)
        })
        .collect();
    for step in 0..steps {
        for ((stream, track), picks) in &rows {
            let sample = stream.timeline.order[picks[step]];
            out.extend_from_slice(&track.values[sample * track.size..(sample + 1) * track.size]);
        }
    }
    out
}
