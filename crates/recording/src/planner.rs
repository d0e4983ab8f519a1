//! The planner: it chooses the mapping, lays out the steps of a plan and inspects the data.

use std::collections::BTreeMap;
use std::path::Path;

use crate::container::Ending;
use crate::error::RecordingError;
use crate::inspect;
use crate::limits::Limits;
use crate::plan::clocks::Clocks;
use crate::plan::streams::{self, Source};
use crate::plan::{ImageStream, Plan, Steps, choice};
use crate::tracks::{Track, Tracks, collect};
use crate::video::Reel;
use gleaner_core::TaskSpec;
use gleaner_core::{FindingCode, Report, Severity};

/// Plans the steps of a recording.
///
/// # Errors
/// [`RecordingError::Rejected`] if no step can be made; findings that leave steps are in the report.
pub(crate) fn plan(path: &Path, spec: &TaskSpec, limits: &Limits) -> Result<Plan, RecordingError> {
    let (spec, own) = (&choice::readable(spec), spec.mappings.len());
    let tracks = collect(path, spec, limits)?;
    let mut report = begin_report(&tracks);
    let at = choice::choose_mapping(&tracks, spec, own, &mut report)?;
    let mapping = &spec.mappings[at];
    let (topics, fixed) = (mapping.topics(spec), mapping.static_topics());
    for entry in &mut report.topics {
        entry.used = topics.contains(entry.topic.as_str()) || fixed.contains(entry.topic.as_str());
    }
    inspect::failures(&tracks, spec, at, &mut report);
    inspect::key_frames(&tracks, spec, at, &mut report);
    let clocks = Clocks::new(&tracks, mapping, spec, &mut report);
    let streams = streams::streams(&tracks, at, spec, &clocks);
    let Some(streams) = streams.filter(|_| !report.has_errors()) else {
        return Err(RecordingError::Rejected(Box::new(report.sorted())));
    };
    let clock_topic = mapping.clock_topic(spec).unwrap_or_default();
    let steps = Steps::new(spec, clocks.timeline(&tracks, clock_topic), streams);
    let uses = Uses::new(&tracks, clock_topic, &steps);
    let (proprioception, action) = (steps.gather(&spec.proprioception), steps.gather(&spec.action));
    inspect::steps(&steps, spec, &mut report);
    inspect::values(&proprioception, &spec.proprioception, &mut report);
    inspect::values(&action, &spec.action, &mut report);
    inspect::outside_limits(&action, &spec.action, &mut report);
    inspect::frozen_joints(&proprioception, &spec.proprioception, &mut report);
    let (stamps, clock_topic) = (steps.stamps.clone(), clock_topic.to_owned());
    Ok(Plan {
        clock_topic,
        stamps,
        declared_late: tracks.undeclared.iter().any(|(_, _, topic)| topic.is_some()),
        reels: reels(tracks.tracks),
        cumulative: mapping.transform_topics().union(&fixed).map(|topic| (*topic).to_owned()).collect(),
        clock: uses.clock,
        log_times: uses.log_times,
        images: uses.images,
        used: uses.used,
        profile: tracks.profile,
        channels: tracks.channels,
        proprioception,
        action,
        report,
    })
}

/// The topics of video.
fn reels(tracks: BTreeMap<String, Track>) -> BTreeMap<String, Reel> {
    let reels = tracks.into_iter().filter_map(|(topic, track)| Some((topic, track.reel?)));
    reels.filter(|(_, reel)| reel.is_video()).collect()
}

/// The messages that the steps use: the fields of the same names in [`Plan`].
struct Uses {
    clock: Vec<usize>,
    log_times: Vec<i64>,
    images: Vec<ImageStream>,
    used: BTreeMap<String, Vec<Vec<usize>>>,
}

impl Uses {
    fn new(tracks: &Tracks, clock_topic: &str, steps: &Steps<'_>) -> Self {
        let clock: Vec<usize> = steps.ticks.iter().map(|&at| steps.clock.order[at]).collect();
        let clock_stamps = tracks.tracks.get(clock_topic).map(|track| track.stamps.as_slice()).unwrap_or_default();
        let mut used = BTreeMap::from([(clock_topic.to_owned(), vec![clock.clone()])]);
        let mut images = Vec::new();
        for (stream, picks) in steps.streams.iter().zip(&steps.picks) {
            let picks: Vec<usize> = picks.iter().map(|&at| stream.message(at)).collect();
            used.entry(stream.topic.clone()).or_default().push(picks.clone());
            if let Source::Images { camera, channel, messages } = &stream.source {
                let (camera, channel, video) = (*camera, *channel, messages.is_some());
                images.push(ImageStream { topic: stream.topic.clone(), camera, channel, picks, video });
            }
        }
        let log_times = clock.iter().map(|&message| clock_stamps[message].log).collect();
        Self { clock, log_times, images, used }
    }
}

/// A report on the file itself: its topics, and whether it is whole and sound.
fn begin_report(tracks: &Tracks) -> Report {
    let messages = tracks.topics.iter().map(|topic| topic.messages).sum();
    let mut report = Report { messages, topics: tracks.topics.clone(), ..Report::default() };
    if tracks.scanned.ending == Ending::Cut {
        let detail = format!(
            "the file ends in the middle; the {messages} whole messages before the cut were read. Let the recorder close \
             its files to get all of them"
        );
        report.add(Severity::Warning, FindingCode::Truncated, "file", None, detail);
    }
    for problem in &tracks.scanned.problems {
        report.add(Severity::Warning, problem.code, problem.subject, None, problem.detail.clone());
    }
    for (channel, count, topic) in &tracks.undeclared {
        let detail = match topic {
            Some(topic) => format!(
                "{count} messages of topic {topic} come before the record that declares their channel; they were read. \
                 Copy the file again if its parts are in the wrong order"
            ),
            None => format!("{count} messages were left out: no record declares their channel; copy the file again"),
        };
        let subject = format!("channel {channel}");
        report.add(Severity::Warning, FindingCode::UndeclaredChannel, &subject, None, detail);
    }
    report
}
