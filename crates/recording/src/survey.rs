//! The survey: one pass over a recording that reads every topic without a task.
//!
//! Bounded like the other passes: fields, values and texts beyond a limit are left out and marked. This module does not
//! depend on plans or steps.

mod cameras;
mod fields;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::path::Path;

use crate::channels::Channels;
use crate::container::{Ending, Record, Scanned, scan};
use crate::dialect::{Decoder, Value};
use crate::error::RecordingError;
use crate::limits::Limits;
use crate::tracks::MAX_MESSAGES;
use cameras::CameraNotes;
use fields::FieldNotes;
use gleaner_core::{FindingCode, Report, Severity, Survey, SurveyedTopic, TopicReport};

/// The number of intervals for each gap below which the messages of a topic are events.
const REGULAR: usize = 20;
/// Median intervals without a message that make a gap, as in an inspection.
const GAP_INTERVALS: f64 = 2.5;

/// Reads what a recording holds. With a folder for pictures, the first picture of each camera is written there as JPEG;
/// depth becomes gray.
///
/// # Errors
/// The reasons why the file cannot be read, or a picture cannot be written.
pub fn survey(path: &Path, limits: &Limits, pictures: Option<&Path>) -> Result<Survey, RecordingError> {
    let mut channels = Channels::new(limits);
    let mut pass = Pass::run(path, limits, pictures.is_some(), &mut channels)?;
    if channels.undeclared().iter().any(|(_, _, topic)| topic.is_some()) {
        channels.rewind();
        pass = Pass::run(path, limits, pictures.is_some(), &mut channels)?;
    }
    let Pass { scanned, profile, mut notes, log } = pass;
    let mut declared = channels.topics().to_vec();
    declared.sort_by(|a, b| a.topic.cmp(&b.topic));
    let mut topics = Vec::new();
    for (number, topic) in declared.into_iter().enumerate() {
        let found = notes.remove(&topic.topic).unwrap_or_default();
        topics.push(found.finish(topic, pictures.map(|folder| (folder, number)))?);
    }
    let duration_ns = log.map_or(0, |(first, last)| last.saturating_sub(first));
    let messages = topics.iter().map(|topic| topic.messages).sum();
    Ok(Survey { profile, messages, duration_ns, topics, findings: findings(&scanned, messages) })
}

fn findings(scanned: &Scanned, messages: u64) -> Vec<gleaner_core::Finding> {
    let mut report = Report::default();
    if scanned.ending == Ending::Cut {
        let detail = format!("the file ends in the middle; the {messages} whole messages before the cut were read");
        report.add(Severity::Warning, FindingCode::Truncated, "file", None, detail);
    }
    for problem in &scanned.problems {
        report.add(Severity::Warning, problem.code, problem.subject, None, problem.detail.clone());
    }
    report.sorted().findings
}

/// One pass over the file.
struct Pass {
    scanned: Scanned,
    profile: String,
    notes: BTreeMap<String, Notes>,
    /// The first and the last log time.
    log: Option<(i64, i64)>,
}

impl Pass {
    fn run(path: &Path, limits: &Limits, pictures: bool, channels: &mut Channels) -> Result<Self, RecordingError> {
        let (mut profile, mut log): (String, Option<(i64, i64)>) = (String::new(), None);
        let mut notes: BTreeMap<String, Notes> = BTreeMap::new();
        let mut budget = fields::Budget::default();
        let scanned = scan(path, limits, &mut |record| match record {
            Record::Message { header, data } => {
                let time = i64::try_from(header.log_time).unwrap_or(i64::MAX);
                log = Some(log.map_or((time, time), |(first, last)| (first.min(time), last.max(time))));
                let Some((topic, _, decoder)) = channels.next(header.channel_id) else { return Ok(()) };
                if !notes.contains_key(topic) {
                    notes.insert(topic.to_owned(), Notes::default());
                }
                match notes.get_mut(topic) {
                    Some(notes) => {
                        notes.push(decoder, time, data, &mut Reader { limits, pictures, budget: &mut budget })
                    }
                    None => Ok(()),
                }
            }
            Record::Header { profile: found } => {
                found.clone_into(&mut profile);
                Ok(())
            }
            Record::Attachment { .. } => Ok(()),
            Record::Schema { .. } | Record::Channel { .. } | Record::Metadata { .. } => {
                channels.declare(&record, &|_| true)
            }
        })?;
        Ok(Self { scanned, profile, notes, log })
    }
}

/// What the notes of all topics share.
struct Reader<'a> {
    limits: &'a Limits,
    pictures: bool,
    budget: &'a mut fields::Budget,
}

/// What is known of one topic so far.
#[derive(Default)]
struct Notes {
    log: Vec<i64>,
    header: Vec<i64>,
    problem: Option<String>,
    unreadable: u64,
    camera: Option<CameraNotes>,
    fields: FieldNotes,
}

impl Notes {
    fn push(
        &mut self,
        decoder: &Result<Decoder, String>,
        log: i64,
        data: &[u8],
        reader: &mut Reader<'_>,
    ) -> Result<(), RecordingError> {
        if self.log.len() >= MAX_MESSAGES {
            let problem = format!("a topic has more than {MAX_MESSAGES} messages; split the recording");
            return Err(RecordingError::TooLarge { problem });
        }
        self.log.push(log);
        let value = decoder.as_ref().map_err(Clone::clone).and_then(|decoder| decoder.decode(data));
        match value {
            Ok(value) => self.read(&value, reader),
            Err(problem) => {
                self.problem.get_or_insert(problem);
                self.unreadable += 1;
            }
        }
        Ok(())
    }

    fn read(&mut self, message: &Value<'_>, reader: &mut Reader<'_>) {
        self.header.extend(message.stamp());
        if self.camera.is_some() || CameraNotes::is_image(message) {
            self.camera.get_or_insert_default().push(message, reader.limits, reader.pictures);
        }
        self.fields.push(message, reader.budget);
    }

    fn finish(self, declared: TopicReport, pictures: Option<(&Path, usize)>) -> Result<SurveyedTopic, RecordingError> {
        let Self { log, header, problem, unreadable, camera, fields } = self;
        // An image without a single readable one is a message like others.
        let TopicReport { topic, schema, encoding, messages, used: _ } = declared;
        let stamped = !log.is_empty() && header.len() == log.len();
        let Intervals { median, longest, gaps } = Intervals::of(if stamped { header } else { log });
        let camera = camera.map(|camera| camera.finish(&topic, pictures)).transpose()?;
        let (fields, more) = fields.finish();
        #[expect(clippy::cast_precision_loss, reason = "a rate needs no more digits")]
        let rate_hz = if median > 0 { 1e9 / median as f64 } else { 0.0 };
        Ok(SurveyedTopic {
            topic,
            schema,
            encoding,
            messages,
            rate_hz,
            stamped,
            gaps,
            longest_interval_ns: longest,
            problem,
            unreadable,
            camera,
            fields,
            more,
        })
    }
}

/// The intervals between messages, in nanoseconds.
struct Intervals {
    median: i64,
    longest: i64,
    gaps: u64,
}

impl Intervals {
    fn of(mut times: Vec<i64>) -> Self {
        times.sort_unstable();
        let mut intervals: Vec<i64> = times.windows(2).map(|pair| pair[1].saturating_sub(pair[0])).collect();
        intervals.sort_unstable();
        let median = intervals.get(intervals.len() / 2).copied().unwrap_or_default();
        #[expect(clippy::cast_precision_loss, reason = "a gap needs no more digits")]
        let is_gap = |interval: &&i64| **interval as f64 > median as f64 * GAP_INTERVALS;
        let gaps = intervals.iter().rev().take_while(is_gap).count();
        // Messages of events come when something happens, so they leave no gaps.
        let regular = gaps <= intervals.len() / REGULAR;
        let gaps = if regular { gaps as u64 } else { 0 };
        Self { median, longest: intervals.last().copied().unwrap_or_default(), gaps }
    }
}
