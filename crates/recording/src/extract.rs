//! Copies the original messages of a kept stretch of a recording into a file of its own.
//!
//! The messages' bytes are not touched: the copy reads as the same steps, with the same task.

mod scores;
mod whole_episode;

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::fs::File;
use std::io::BufWriter;
use std::ops::RangeInclusive;
use std::path::Path;

use mcap::records::{MessageHeader, Metadata};

use crate::channels::Channels;
use crate::container::{Record, scan};
use crate::copy::Copier;
use crate::error::RecordingError;
use crate::limits::Limits;
use crate::plan::Plan;
use crate::planner::plan;
use crate::validate::validate;
use crate::whole_file::write_whole;
use crate::write::mcap_writer;
use gleaner_core::TaskSpec;
use scores::ScoreChannels;
use serde::{Deserialize, Serialize};

pub use whole_episode::WholeEpisode;

/// Consecutive steps of an episode with what a score run states of each.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Kept {
    /// First step of the stretch.
    pub first_step: u64,
    /// Each step's score, from the first step on.
    pub scores: Vec<StepScore>,
    /// Further entries of the metadata record `gleaner`: names with values, for people.
    pub about: BTreeMap<String, String>,
}

#[cfg(test)]
impl Kept {
    /// A stretch with the same score for every step, for tests that do not look at scores.
    pub(crate) fn unscored(first_step: u64, steps: usize) -> Self {
        Self { first_step, scores: vec![StepScore::default(); steps], about: BTreeMap::new() }
    }
}

/// What a score run states of one step.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StepScore {
    /// q: from 0 to 1.
    pub q: f32,
    /// w: the similarity on which q rests.
    #[serde(with = "bits")]
    pub w: f64,
    /// Whether the segment that ends at the step is kept.
    pub kept: bool,
    /// The nearest expert and its step, if the scorer matches any.
    pub matched: Option<(String, u32)>,
}

/// 64-bit floats as their bits: decimal digits are read back with a rounding.
mod bits {
    use serde::{Deserialize as _, Deserializer, Serializer};

    #[expect(clippy::trivially_copy_pass_by_ref, reason = "serde passes references")]
    pub(super) fn serialize<S: Serializer>(value: &f64, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_u64(value.to_bits())
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
        u64::deserialize(deserializer).map(f64::from_bits)
    }
}

/// Writes one stretch of a recording to `out`: its original messages unchanged, what a score run states of each step, and
/// a metadata record `gleaner` that names the source.
///
/// Scores have the dialect of the recording, so that its readers and viewers read them too: beside ROS 2 messages
/// `/gleaner/q`, `/gleaner/w` and their like, of `std_msgs`; else the message `gleaner.Quality` on `/gleaner/quality`.
///
/// The copy has, for each topic of the task, the messages that the steps use and those between them; for each other topic,
/// the messages logged during the stretch. Video also has the messages from the key frame before the stretch, on which its
/// pictures depend, and transforms of frames have those from the recording's beginning on. The copy of a whole episode has
/// every message of the recording. Attachments are not copied.
///
/// # Errors
/// Like [`crate::read_episode`], and [`RecordingError::Step`] if the stretch is not in the episode.
pub fn extract(path: &Path, spec: &TaskSpec, kept: &Kept, out: &Path) -> Result<(), RecordingError> {
    validate(spec)?;
    let plan = plan(path, spec, &Limits::ADMITTED)?;
    let steps = check(kept, plan.stamps.len())?;
    let whole = steps.clone().count() == plan.stamps.len();
    let (video, transforms) = (plan.reels.contains_key(&plan.clock_topic), plan.cumulative.contains(&plan.clock_topic));
    if !whole && (video || transforms) {
        let problem = format!(
            "the clock is {}, a topic of {}, whose messages before a stretch would be steps of its copy; set `clock` to \
             another topic",
            plan.clock_topic,
            if video { "video" } else { "transforms" }
        );
        return Err(RecordingError::Spec { field: format!("mapping {}", plan.report.mapping), problem });
    }
    let source = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let origin = [
        ("source", source),
        ("task", spec.name.clone()),
        ("mapping", plan.report.mapping.clone()),
        ("first_step", steps.start().to_string()),
        ("last_step", steps.end().to_string()),
    ];
    let origin = origin.into_iter().map(|(key, value)| (key.to_owned(), value));
    let origin = kept.about.clone().into_iter().chain(origin).collect();
    let ros = plan.report.topics.iter().any(|topic| topic.topic == plan.clock_topic && topic.encoding == "cdr");
    write_whole(out, |file| {
        let mut writer = mcap_writer(file, &plan.profile)?;
        let copy = Copy {
            whole,
            keep: keep(&plan, &steps),
            clock: plan.clock_topic.as_str(),
            ticks: steps.clone().map(|step| (plan.clock[step], step)).collect(),
            window: plan.log_times[*steps.start()]..=plan.log_times[*steps.end()],
            first_step: *steps.start(),
            scores: &kept.scores,
            stamps: &plan.stamps,
            channels: ScoreChannels::new(&mut writer, ros)?,
            copier: Copier::new(writer),
        };
        copy.run(path, plan.channels, plan.declared_late, origin)
    })
}

/// The stretch as a range of steps.
fn check(kept: &Kept, steps: usize) -> Result<RangeInclusive<usize>, RecordingError> {
    let first = usize::try_from(kept.first_step).ok();
    let last = first.and_then(|first| first.checked_add(kept.scores.len().checked_sub(1)?));
    match first.zip(last).filter(|(_, last)| *last < steps) {
        Some((first, last)) => Ok(first..=last),
        None => {
            let problem = format!(
                "a stretch of {} steps is not within the episode's {steps} steps; give at least one score, and no more than \
                 there are steps from the first on",
                kept.scores.len()
            );
            Err(RecordingError::Step { step: kept.first_step, problem })
        }
    }
}

/// The messages of a topic to keep.
#[derive(Default)]
struct KeptMessages {
    some: BTreeSet<usize>,
    /// And all before this one.
    before: usize,
}

/// For each topic that the task reads, the messages to keep.
fn keep(plan: &Plan, steps: &RangeInclusive<usize>) -> HashMap<String, KeptMessages> {
    let mut keep: HashMap<String, KeptMessages> = HashMap::new();
    for (topic, streams) in &plan.used {
        let messages = &mut keep.entry(topic.clone()).or_default().some;
        for picks in streams {
            let used = &picks[steps.clone()];
            if topic == &plan.clock_topic {
                // Only the ticks themselves: those that were thinned out would change the grid.
                messages.extend(used);
            } else if let (Some(&first), Some(&last)) = (used.iter().min(), used.iter().max()) {
                messages.extend(first..=last);
            }
        }
        if let Some(reel) = plan.reels.get(topic) {
            // Pictures before the stretch are there for decoding only: no step uses them.
            *messages = reel.needed(messages);
        }
    }
    for topic in &plan.cumulative {
        let messages = keep.entry(topic.clone()).or_default();
        // All of a topic that never changes, whenever they come; of others those up to the stretch's last one.
        messages.before = messages.some.last().map_or(usize::MAX, |last| last + 1);
    }
    keep
}

struct Copy<'a> {
    /// Whether every step is in the copy, and therefore every message.
    whole: bool,
    keep: HashMap<String, KeptMessages>,
    clock: &'a str,
    /// The step of each kept message of the clock.
    ticks: HashMap<usize, usize>,
    /// Log times of the stretch.
    window: RangeInclusive<i64>,
    first_step: usize,
    scores: &'a [StepScore],
    /// Of every step of the episode.
    stamps: &'a [i64],
    channels: ScoreChannels,
    copier: Copier<BufWriter<File>>,
}

impl Copy<'_> {
    fn run(
        mut self,
        path: &Path,
        mut channels: Channels,
        declared_late: bool,
        origin: BTreeMap<String, String>,
    ) -> Result<BufWriter<File>, RecordingError> {
        if declared_late {
            scan(path, &Limits::ADMITTED, &mut |record| match record {
                Record::Schema { .. } | Record::Channel { .. } => self.declare(&record),
                Record::Header { .. }
                | Record::Message { .. }
                | Record::Metadata { .. }
                | Record::Attachment { .. } => Ok(()),
            })?;
        }
        scan(path, &Limits::ADMITTED, &mut |record| {
            if let Record::Message { header, data } = record {
                let Some((topic, at, _)) = channels.next(header.channel_id) else { return Ok(()) };
                self.message(topic, at, header, data)?;
                return self.score(topic, at, header);
            }
            self.declare(&record)
        })?;
        let origin = Metadata { name: "gleaner".to_owned(), metadata: origin };
        self.copier.writer.write_metadata(&origin).map_err(RecordingError::Write)?;
        self.copier.finish()
    }

    /// Copies a declaration, except of the scores of an earlier copy.
    fn declare(&mut self, record: &Record<'_>) -> Result<(), RecordingError> {
        let own = matches!(record, Record::Channel { topic, .. } if scores::is_own(topic));
        if own { Ok(()) } else { self.copier.declare(record) }
    }

    fn message(&mut self, topic: &str, at: usize, header: MessageHeader, data: &[u8]) -> Result<(), RecordingError> {
        let wanted = match self.keep.get(topic) {
            _ if self.whole => true,
            Some(messages) => at < messages.before || messages.some.contains(&at),
            None => i64::try_from(header.log_time).is_ok_and(|time| self.window.contains(&time)),
        };
        if wanted { self.copier.message(header, data) } else { Ok(()) }
    }

    /// After a message of the clock that is kept, the score of its step.
    fn score(&mut self, topic: &str, at: usize, header: MessageHeader) -> Result<(), RecordingError> {
        let Some(&step) = self.ticks.get(&at).filter(|_| topic == self.clock) else {
            return Ok(());
        };
        let score = step.checked_sub(self.first_step).and_then(|within| self.scores.get(within));
        let (Some(score), Some(&stamp)) = (score, self.stamps.get(step)) else { return Ok(()) };
        self.channels.write(&mut self.copier.writer, header, (stamp, step), score)
    }
}

#[cfg(test)]
mod tests;
