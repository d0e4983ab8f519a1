//! Cuts one long recording into episodes, at the messages of an event topic or by ranges of time.
//!
//! A message of the topic begins an episode, which ends at the next one, unless its content states otherwise ([`Event`]).
//! Messages are copied unchanged, by the time at which they were logged. An episode begins with the earlier messages of
//! topics whose messages hold for those who come later, such as `/tf_static`. Memory follows the largest chunk and the number of events.

mod event;
mod latched;
mod range;

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use mcap::records::MessageHeader;
use serde::{Deserialize, Serialize};

use crate::channels::Channels;
use crate::container::{Record, scan};
use crate::copy::Copier;
use crate::error::RecordingError;
use crate::limits::Limits;
use crate::write::write_options;
use event::Event;
use latched::Latched;

pub use range::TimeRange;

/// Larger chunks than those of our recordings, because the file is not read while it is written.
const CHUNK_BYTES: u64 = 1 << 20;
/// The library in the header: the same for every release that writes the same bytes.
const LIBRARY: &str = "gleaner cut 1";
/// A recorder writes messages of several threads: one may lie this many nanoseconds after its place in the file.
const DISORDER: u64 = 2_000_000_000;
/// Most episodes of a recording.
const MOST_EPISODES: usize = 100_000;

/// What marks the episodes of a recording.
#[derive(Clone, Copy, Debug)]
pub enum Cuts<'a> {
    /// The messages of this topic.
    Topic(&'a str),
    /// These times. The episodes are in the order of time.
    Ranges(&'a [TimeRange]),
}

/// An episode that was cut out of a recording.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct CutEpisode {
    /// Its file in the folder.
    pub file_name: String,
    /// Whether it succeeded, if its range or the event that ends it states so.
    pub success: Option<bool>,
}

/// The time of an episode, in nanoseconds; the end is not part of it.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Span {
    begin: u64,
    end: u64,
    success: Option<bool>,
}

/// Cuts a recording into files of a folder, one for each episode: the same recording gives the same bytes.
///
/// # Errors
/// [`RecordingError::Field`] if the topic is not there or marks no episode; [`RecordingError::Ranges`] if a range is not one
/// of the recording; the errors of reading the recording; [`RecordingError::Write`] and `Io`.
pub fn cut(path: &Path, cuts: Cuts<'_>, limits: &Limits, folder: &Path) -> Result<Vec<CutEpisode>, RecordingError> {
    let spans = match cuts {
        Cuts::Topic(topic) => marked(path, topic, limits)?,
        Cuts::Ranges(ranges) => range::spans(ranges, times(path, limits)?)?,
    };
    let name = |at: usize| format!("episode_{at:06}.mcap");
    let mut cut = Cut {
        spans: &spans,
        folder,
        name: &name,
        profile: String::new(),
        declared: Vec::new(),
        latched: Latched::default(),
        open: BTreeMap::new(),
        closed: 0,
    };
    scan(path, limits, &mut |record| cut.record(&record))?;
    cut.finish()?;
    let episode = |(at, span): (usize, &Span)| CutEpisode { file_name: name(at), success: span.success };
    Ok(spans.iter().enumerate().map(episode).collect())
}

/// The episodes that the messages of a topic mark, in order.
fn marked(path: &Path, topic: &str, limits: &Limits) -> Result<Vec<Span>, RecordingError> {
    let mut channels = Channels::new(limits);
    let mut events: Vec<(u64, Event)> = Vec::new();
    let wrong = |problem: String| RecordingError::Field { topic: topic.to_owned(), path: "-".to_owned(), problem };
    scan(path, limits, &mut |record| {
        let Record::Message { header, data } = record else {
            return channels.declare(&record, &|known| known == topic);
        };
        let Some((found, _, decoder)) = channels.next(header.channel_id) else { return Ok(()) };
        if found == topic {
            let event = match decoder.as_ref() {
                Ok(decoder) => decoder.decode(data).map(|value| Event::of(&value)).map_err(&wrong)?,
                // A message that cannot be read still marks a moment.
                Err(_) => Event::Begin,
            };
            events.push((header.log_time, event));
            if events.len() > MOST_EPISODES {
                return Err(wrong(format!(
                    "it has more than {MOST_EPISODES} messages; mark episodes on a topic of their own"
                )));
            }
        }
        Ok(())
    })?;
    if events.is_empty() {
        let known: Vec<&str> = channels.topics().iter().map(|known| known.topic.as_str()).take(32).collect();
        return Err(wrong(format!("the recording has no message of it; its topics are {}", known.join(", "))));
    }
    events.sort_by_key(|(time, _)| *time);
    let counted = events.iter().any(|(_, event)| event.counts());
    let mut spans: Vec<Span> = Vec::new();
    let mut open: Option<u64> = None;
    for (time, event) in events {
        let (ended, event) = (open.take(), event.resolved(counted));
        match event {
            Event::Discard => {}
            Event::Begin | Event::End(_) | Event::Number(_) => {
                spans.extend(ended.filter(|begin| *begin < time).map(|begin| Span {
                    begin,
                    end: time,
                    success: if let Event::End(success) = event { success } else { None },
                }))
            }
        }
        open = (event == Event::Begin).then_some(time);
    }
    spans.extend(open.map(|begin| Span { begin, end: u64::MAX, success: None }));
    if spans.is_empty() {
        return Err(wrong("its messages mark no episode: none begins one".to_owned()));
    }
    Ok(spans)
}

/// The times of a recording's first and last message.
fn times(path: &Path, limits: &Limits) -> Result<(u64, u64), RecordingError> {
    let mut times: Option<(u64, u64)> = None;
    scan(path, limits, &mut |record| {
        if let Record::Message { header, .. } = record {
            let (first, last) = times.unwrap_or((header.log_time, header.log_time));
            times = Some((first.min(header.log_time), last.max(header.log_time)));
        }
        Ok(())
    })?;
    times.ok_or_else(|| RecordingError::Ranges { problem: "the recording has no messages to cut".to_owned() })
}

/// The episodes that are being written.
struct Cut<'a> {
    spans: &'a [Span],
    folder: &'a Path,
    name: &'a dyn Fn(usize) -> String,
    profile: String,
    /// Schemas and channels so far, for episodes that begin later.
    declared: Vec<Declared>,
    latched: Latched,
    open: BTreeMap<usize, Copier<BufWriter<File>>>,
    /// Episodes before this one are complete.
    closed: usize,
}

/// A schema or a channel.
enum Declared {
    Schema { id: u16, name: String, encoding: String, data: Vec<u8> },
    Channel { id: u16, schema_id: u16, topic: String, encoding: String, metadata: BTreeMap<String, String> },
}

impl Declared {
    fn of(record: &Record<'_>) -> Option<Self> {
        match record {
            Record::Schema { id, name, encoding, data } => Some(Self::Schema {
                id: *id,
                name: (*name).to_owned(),
                encoding: (*encoding).to_owned(),
                data: data.to_vec(),
            }),
            Record::Channel { id, schema_id, topic, encoding, metadata } => Some(Self::Channel {
                id: *id,
                schema_id: *schema_id,
                topic: (*topic).to_owned(),
                encoding: (*encoding).to_owned(),
                metadata: metadata.clone(),
            }),
            Record::Header { .. } | Record::Message { .. } | Record::Metadata { .. } | Record::Attachment { .. } => {
                None
            }
        }
    }

    fn record(&self) -> Record<'_> {
        match self {
            Self::Schema { id, name, encoding, data } => Record::Schema { id: *id, name, encoding, data },
            Self::Channel { id, schema_id, topic, encoding, metadata } => {
                Record::Channel { id: *id, schema_id: *schema_id, topic, encoding, metadata: metadata.clone() }
            }
        }
    }
}

impl Cut<'_> {
    fn record(&mut self, record: &Record<'_>) -> Result<(), RecordingError> {
        match record {
            Record::Header { profile } => {
                (*profile).clone_into(&mut self.profile);
                Ok(())
            }
            Record::Message { header, data } => self.message(*header, data),
            Record::Schema { .. } | Record::Channel { .. } => {
                if let Record::Channel { id, topic, metadata, .. } = record {
                    self.latched.declare(*id, topic, metadata);
                }
                self.declared.extend(Declared::of(record));
                self.open.values_mut().try_for_each(|copier| copier.declare(record))
            }
            Record::Metadata { .. } | Record::Attachment { .. } => Ok(()),
        }
    }

    fn message(&mut self, header: MessageHeader, data: &[u8]) -> Result<(), RecordingError> {
        let time = header.log_time;
        self.latched.push(header, data);
        while self.spans.get(self.closed).is_some_and(|span| span.end.saturating_add(DISORDER) < time) {
            self.close(self.closed)?;
            self.closed += 1;
        }
        let Some(at) = self.spans.partition_point(|span| span.begin <= time).checked_sub(1) else { return Ok(()) };
        if self.spans.get(at).is_none_or(|span| time >= span.end) {
            return Ok(());
        }
        if at < self.closed {
            let problem = "its messages are out of order by more than two seconds; sort it with `mcap sort`";
            return Err(RecordingError::Damaged { problem: problem.to_owned() });
        }
        if !self.open.contains_key(&at) {
            let copier = self.begin(at)?;
            self.open.insert(at, copier);
        }
        self.open.get_mut(&at).map_or(Ok(()), |copier| copier.message(header, data))
    }

    fn begin(&self, at: usize) -> Result<Copier<BufWriter<File>>, RecordingError> {
        let path = self.path(at);
        let file = File::create(&path).map_err(|source| RecordingError::Io { path, source })?;
        let writer = write_options(&self.profile, CHUNK_BYTES).library(LIBRARY).create(BufWriter::new(file));
        let mut copier = Copier::new(writer.map_err(RecordingError::Write)?);
        self.declared.iter().try_for_each(|declared| copier.declare(&declared.record()))?;
        let begin = self.spans.get(at).map_or(0, |span| span.begin);
        self.latched.before(begin).try_for_each(|(header, data)| copier.message(header, data))?;
        Ok(copier)
    }

    /// Ends an episode; one without a message is a file too, which an upload rejects by name.
    fn close(&mut self, at: usize) -> Result<(), RecordingError> {
        let copier = match self.open.remove(&at) {
            Some(copier) => copier,
            None => self.begin(at)?,
        };
        let file = copier
            .finish()?
            .into_inner()
            .map_err(|error| RecordingError::Io { path: self.path(at), source: error.into_error() })?;
        drop(file);
        Ok(())
    }

    fn finish(mut self) -> Result<(), RecordingError> {
        (self.closed..self.spans.len()).try_for_each(|at| self.close(at))
    }

    fn path(&self, at: usize) -> PathBuf {
        self.folder.join((self.name)(at))
    }
}

#[cfg(test)]
mod tests;
