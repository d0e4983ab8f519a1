//! Copies the original messages of a kept stretch of a recording into a file of its own.
//!
//! The messages' bytes are not touched: the copy reads as the same steps, with the same task.

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

/// Topic of each kept step's q and w.
const QUALITY_TOPIC: &str = "/gleaner/quality";

/// A stretch of steps to keep.
#[derive(Clone, Debug, PartialEq)]
pub struct Kept {
    /// First step of the stretch.
    pub first_step: u64,
    /// Last step of the stretch, inclusive.
    pub last_step: u64,
    /// q of each step of the stretch.
    pub quality: Vec<f32>,
    /// w of each step of the stretch.
    pub weight: Vec<f32>,
}

/// Writes one stretch of a recording to `out`: its original messages unchanged, q and w of each step as JSON
/// on `/gleaner/quality`, and a metadata record `gleaner` that names the source.
///
/// The copy has, for each topic of the task, the messages that the steps use and those between them; for each other topic,
/// the messages logged during the stretch. Video also has the messages from the key frame before the stretch, on which its
/// pictures depend.
///
/// # Errors
/// Like [`crate::read_episode`], and [`RecordingError::Step`] if the stretch is not in the episode.
pub fn extract(path: &Path, spec: &TaskSpec, kept: &Kept, out: &Path) -> Result<(), RecordingError> {
    validate(spec)?;
    let plan = plan(path, spec, &Limits::ADMITTED)?;
    let steps = check(kept, plan.stamps.len())?;
    if plan.reels.contains_key(&plan.clock_topic) {
        let problem = format!(
            "the clock is {}, a topic of video, whose messages before a stretch would be steps of its copy; set `clock` to a \
             topic of numbers",
            plan.clock_topic
        );
        return Err(RecordingError::Spec { field: format!("mapping {}", plan.report.mapping), problem });
    }
    let source = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let origin = [
        ("source", source),
        ("task", spec.name.clone()),
        ("mapping", plan.report.mapping.clone()),
        ("first_step", kept.first_step.to_string()),
        ("last_step", kept.last_step.to_string()),
    ];
    let origin = origin.into_iter().map(|(key, value)| (key.to_owned(), value)).collect();
    write_whole(out, |file| {
        let mut writer = mcap_writer(file, &plan.profile)?;
        let quality = writer.add_channel(0, QUALITY_TOPIC, "json", &BTreeMap::new()).map_err(RecordingError::Write)?;
        let copy = Copy {
            keep: keep(&plan, &steps),
            clock: plan.clock_topic.as_str(),
            ticks: steps.clone().map(|step| (plan.clock[step], step)).collect(),
            window: plan.log_times[*steps.start()]..=plan.log_times[*steps.end()],
            kept,
            quality,
            copier: Copier::new(writer),
        };
        copy.run(path, plan.channels, plan.declared_late, origin)
    })
}

/// The stretch as a range of steps.
fn check(kept: &Kept, steps: usize) -> Result<RangeInclusive<usize>, RecordingError> {
    let wrong = |problem: String| RecordingError::Step { step: kept.first_step, problem };
    let range = usize::try_from(kept.first_step).ok().zip(usize::try_from(kept.last_step).ok());
    let Some((first, last)) = range.filter(|(first, last)| first <= last && *last < steps) else {
        return Err(wrong(format!(
            "the stretch up to step {} is not within the episode's {steps} steps; give first ≤ last < {steps}",
            kept.last_step
        )));
    };
    for (name, values) in [("quality", &kept.quality), ("weight", &kept.weight)] {
        if values.len() != last - first + 1 {
            return Err(wrong(format!(
                "{name} has {} values for {} steps; give one a step",
                values.len(),
                last - first + 1
            )));
        }
    }
    Ok(first..=last)
}

/// For each topic that the task reads, the messages to keep.
fn keep(plan: &Plan, steps: &RangeInclusive<usize>) -> HashMap<String, BTreeSet<usize>> {
    let mut keep = HashMap::new();
    for (topic, streams) in &plan.used {
        let messages: &mut BTreeSet<usize> = keep.entry(topic.clone()).or_default();
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
    keep
}

struct Copy<'a> {
    keep: HashMap<String, BTreeSet<usize>>,
    clock: &'a str,
    /// The step of each kept message of the clock.
    ticks: HashMap<usize, usize>,
    /// Log times of the stretch.
    window: RangeInclusive<i64>,
    kept: &'a Kept,
    /// Channel of the q and w.
    quality: u16,
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
                Record::Schema { .. } | Record::Channel { .. } => self.copier.declare(&record),
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
                return self.quality(topic, at, header);
            }
            self.copier.declare(&record)
        })?;
        let origin = Metadata { name: "gleaner".to_owned(), metadata: origin };
        self.copier.writer.write_metadata(&origin).map_err(RecordingError::Write)?;
        self.copier.finish()
    }

    fn message(&mut self, topic: &str, at: usize, header: MessageHeader, data: &[u8]) -> Result<(), RecordingError> {
        let wanted = match self.keep.get(topic) {
            // An extract of an extract has its own.
            _ if topic == QUALITY_TOPIC => false,
            Some(messages) => messages.contains(&at),
            None => i64::try_from(header.log_time).is_ok_and(|time| self.window.contains(&time)),
        };
        if wanted { self.copier.message(header, data) } else { Ok(()) }
    }

    /// After a kept message of the clock, its step's q and w.
    fn quality(&mut self, topic: &str, at: usize, header: MessageHeader) -> Result<(), RecordingError> {
        let Some(&step) = self.ticks.get(&at).filter(|_| topic == self.clock) else {
            return Ok(());
        };
        // The stretch was checked to begin at or before the step and to hold a value for it.
        let within = usize::try_from(self.kept.first_step).map_or(0, |first| step.saturating_sub(first));
        let value = serde_json::json!({"step": step, "q": self.kept.quality[within], "w": self.kept.weight[within]});
        let header = MessageHeader { channel_id: self.quality, ..header };
        self.copier.writer.write_to_known_channel(&header, value.to_string().as_bytes()).map_err(RecordingError::Write)
    }
}

#[cfg(test)]
mod tests;
