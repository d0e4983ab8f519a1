//! Cuts one long recording into episodes, at the messages of an event topic or by ranges of time.
//!
//! A message of the topic begins an episode, which ends at the next one, unless its content states otherwise
//! ([`event::Event`]).
//! Messages are copied unchanged, by the time at which they were logged. An episode begins with the earlier messages of
//! topics whose messages hold for those who come later, such as `/tf_static`. Memory follows the largest chunk and the number of events.

mod declared;
mod event;
mod latched;
mod look;
mod marks;
mod range;

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::time::Duration;

use mcap::records::MessageHeader;
use serde::{Deserialize, Serialize};

use crate::container::{Record, scan};
use crate::copy::Copier;
use crate::error::RecordingError;
use crate::limits::Limits;
use crate::write::write_options;
use declared::Declared;
use latched::Latched;
use look::Look;

pub use range::TimeRange;

/// Larger chunks than those of our recordings, because the file is not read while it is written.
const CHUNK_BYTES: u64 = 1 << 20;
/// The library in the header: the same for every release that writes the same bytes.
const LIBRARY: &str = "gleaner cut 1";
/// A recorder writes messages of several threads: one may lie this many nanoseconds after its place in the file.
const DISORDER: u64 = 2_000_000_000;
/// An episode that is cut out of a recording without its end is to end this many nanoseconds before the last message.
const BEFORE_THE_END: u64 = 20_000_000;

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
    /// Why it is left out, with the fix; there is no file of it then.
    pub left_out: Option<String>,
}

/// The time of an episode, in nanoseconds; the end is not part of it.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Span {
    begin: u64,
    end: u64,
    success: Option<bool>,
}

/// Cuts a recording into files of a folder, one for each episode: the same recording gives the same bytes. If the recording
/// ends in the middle, as after a crash of its recorder, the episode that reaches its end is left out.
///
/// # Errors
/// [`RecordingError::Field`] if the topic is not there or marks no episode; [`RecordingError::Ranges`] if a range is not one
/// of the recording; [`RecordingError::Damaged`] if other parts than its end are lost; the errors of reading the recording;
/// [`RecordingError::Write`] and `Io`.
pub fn cut(path: &Path, cuts: Cuts<'_>, limits: &Limits, folder: &Path) -> Result<Vec<CutEpisode>, RecordingError> {
    let topic = if let Cuts::Topic(topic) = cuts { Some(topic) } else { None };
    let look = Look::at(path, topic, limits)?;
    let no_messages = || RecordingError::Ranges { problem: "the recording has no messages to cut".to_owned() };
    let spans = match cuts {
        Cuts::Topic(topic) => marks::spans(topic, &look)?,
        Cuts::Ranges(ranges) => range::spans(ranges, look.times.ok_or_else(no_messages)?)?,
    };
    let name = |at: usize| format!("episode_{at:06}.mcap");
    let left_out: Vec<Option<String>> = spans.iter().map(|span| left_out(span, &look)).collect();
    // It is the last one in time that reaches the end.
    let whole = left_out.iter().take_while(|reason| reason.is_none()).count();
    let mut cut = Cut {
        spans: spans.get(..whole).unwrap_or_default(),
        folder,
        name: &name,
        profile: String::new(),
        declared: Vec::new(),
        latched: Latched::default(),
        open: BTreeMap::new(),
        closed: 0,
    };
    look.late.into_iter().for_each(|declared| cut.declare(declared));
    scan(path, limits, &mut |record| cut.record(&record))?;
    cut.finish()?;
    let episodes = spans.iter().zip(left_out).enumerate();
    let episode = |(at, (span, left_out)): (usize, (&Span, Option<String>))| CutEpisode {
        file_name: name(at),
        success: span.success,
        left_out,
    };
    Ok(episodes.map(episode).collect())
}

/// Why an episode is left out: the end of the recording is missing, and so may be its own.
fn left_out(span: &Span, look: &Look) -> Option<String> {
    let (first, last) = look.times?;
    (look.is_cut_off && span.end > last).then(|| {
        let end = Duration::from_nanos(last.saturating_sub(first).saturating_sub(BEFORE_THE_END)).as_millis() / 10;
        format!(
            "the recording ends in the middle of it, as after a crash of its recorder; what there is of it can be cut out as \
             a range of time that ends at {}.{:02} s or before",
            end / 100,
            end % 100
        )
    })
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

impl Cut<'_> {
    fn record(&mut self, record: &Record<'_>) -> Result<(), RecordingError> {
        match record {
            Record::Header { profile } => {
                (*profile).clone_into(&mut self.profile);
                Ok(())
            }
            Record::Message { header, data } => self.message(*header, data),
            Record::Schema { .. } | Record::Channel { .. } => {
                Declared::of(record).into_iter().for_each(|declared| self.declare(declared));
                self.open.values_mut().try_for_each(|copier| copier.declare(record))
            }
            Record::Metadata { .. } | Record::Attachment { .. } => Ok(()),
        }
    }

    /// Keeps a declaration for the episodes that begin later.
    fn declare(&mut self, declared: Declared) {
        if let Declared::Channel { id, topic, metadata, .. } = &declared {
            self.latched.declare(*id, topic, metadata);
        }
        self.declared.push(declared);
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
