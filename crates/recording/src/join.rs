//! Joins the parts of a recording, into which its recorder has cut it by size or duration, to one file.
//!
//! Schemas and channels that the parts repeat are declared once; messages keep their order, attachments and metadata are
//! kept. Memory follows the largest chunk of a part and the number of chunks, not the length. Independent of dialects,
//! tasks and of the names of files.

use std::collections::{BTreeMap, HashSet};
use std::io::Write;
use std::path::{Path, PathBuf};

use mcap::write::NoSeek;
use mcap::{Attachment, McapError};

use crate::container::{Ending, Record, Scanned, scan};
use crate::copy::Copier;
use crate::error::RecordingError;
use crate::limits::Limits;
use crate::write::write_options;
use gleaner_core::RecordingSummary;

/// Larger chunks than those of our recordings, because the file is not read while it is written.
const CHUNK_BYTES: u64 = 1 << 20;
/// The library in the header: the same for every release that writes the same bytes.
const LIBRARY: &str = "gleaner join 1";
/// A recorder writes messages of several threads, so the end of a part may reach this far into the next one, in
/// nanoseconds.
const OVERLAP: u64 = 1_000_000_000;

/// Writes the parts of a recording, in their order, as one recording to `out`, and returns its summary. The same parts
/// give the same bytes.
///
/// # Errors
/// [`RecordingError::Part`] names a part that is cut, damaged or of another kind, or that does not follow the part before
/// it in time; the errors of reading a part; [`RecordingError::Write`] if `out` fails.
pub fn join(parts: &[PathBuf], out: impl Write) -> Result<RecordingSummary, RecordingError> {
    let mut joint = Joint { out: Some(NoSeek::new(out)), ..Joint::default() };
    for path in parts {
        joint.part(path)?;
    }
    joint.finish(parts)
}

/// The recording that is being written.
struct Joint<W: Write> {
    /// The output until the profile of the first part is known.
    out: Option<NoSeek<W>>,
    copier: Option<Copier<NoSeek<W>>>,
    profile: String,
    metadata: HashSet<(String, BTreeMap<String, String>)>,
    /// The last part that has messages.
    before: Option<(PathBuf, Times)>,
}

/// First and last log time of a part.
#[derive(Clone, Copy)]
struct Times(u64, u64);

impl<W: Write> Default for Joint<W> {
    fn default() -> Self {
        Self { out: None, copier: None, profile: String::new(), metadata: HashSet::new(), before: None }
    }
}

impl<W: Write> Joint<W> {
    fn part(&mut self, path: &Path) -> Result<(), RecordingError> {
        if let Some(copier) = &mut self.copier {
            copier.next_source();
        }
        let mut times: Option<Times> = None;
        let scanned = scan(path, &Limits::ADMITTED, &mut |record| {
            if let Record::Message { header, .. } = &record {
                let Times(first, last) = times.unwrap_or(Times(header.log_time, header.log_time));
                times = Some(Times(first.min(header.log_time), last.max(header.log_time)));
            }
            self.record(path, &record)
        });
        let scanned = scanned.map_err(|error| {
            // These errors do not name their file.
            let unnamed = matches!(error, RecordingError::Damaged { .. } | RecordingError::TooLarge { .. });
            if unnamed { wrong(path, &error.to_string()) } else { error }
        })?;
        check_whole(path, &scanned)?;
        let Some(times) = times else { return Ok(()) };
        if let Some((before, earlier)) = &self.before {
            check_order(path, times, before, *earlier)?;
        }
        self.before = Some((path.to_owned(), times));
        Ok(())
    }

    fn record(&mut self, path: &Path, record: &Record<'_>) -> Result<(), RecordingError> {
        if let Record::Header { profile } = record {
            return self.header(path, profile);
        }
        let Some(copier) = &mut self.copier else {
            return Err(wrong(path, "it does not begin with a header; record or copy the file again"));
        };
        match record {
            Record::Message { header, data } if copier.declares(header.channel_id) => copier.message(*header, data),
            Record::Message { header, .. } => Err(wrong(
                path,
                &format!(
                    "no record before it declares channel {} of a message; copy the file again",
                    header.channel_id
                ),
            )),
            Record::Metadata { name, values } if !self.metadata.insert(((*name).to_owned(), values.clone())) => Ok(()),
            Record::Attachment { log_time, create_time, name, media_type, data } => {
                let attachment = Attachment {
                    log_time: *log_time,
                    create_time: *create_time,
                    name: (*name).to_owned(),
                    media_type: (*media_type).to_owned(),
                    data: (*data).into(),
                };
                copier.writer.attach(&attachment).map_err(RecordingError::Write)
            }
            Record::Header { .. } | Record::Schema { .. } | Record::Channel { .. } | Record::Metadata { .. } => {
                copier.declare(record)
            }
        }
    }

    fn header(&mut self, path: &Path, profile: &str) -> Result<(), RecordingError> {
        match self.out.take() {
            Some(out) => {
                let writer = write_options(profile, CHUNK_BYTES).library(LIBRARY).create(out);
                self.copier = Some(Copier::new(writer.map_err(RecordingError::Write)?));
                profile.clone_into(&mut self.profile);
                Ok(())
            }
            None if profile == self.profile => Ok(()),
            None => Err(wrong(
                path,
                &format!(
                    "its profile is {profile:?}, and that of the parts before it {:?}; push it as a recording of its own",
                    self.profile
                ),
            )),
        }
    }

    fn finish(self, parts: &[PathBuf]) -> Result<RecordingSummary, RecordingError> {
        let Some(mut copier) = self.copier else {
            let path = parts.first().cloned().unwrap_or_default();
            return Err(wrong(&path, "there is no part with a header"));
        };
        let summary = copier.writer.finish().map_err(RecordingError::Write)?;
        summarized(&summary).ok_or(RecordingError::Write(McapError::UnexpectedEof))
    }
}

/// Damage of one part would not be seen in the joint recording.
fn check_whole(path: &Path, scanned: &Scanned) -> Result<(), RecordingError> {
    if scanned.ending == Ending::Cut {
        let problem =
            "the file ends in the middle; let the recorder close its files, or recover it with `mcap recover`";
        return Err(wrong(path, problem));
    }
    match scanned.problems.first() {
        Some(problem) => {
            let fix = "recover it with `mcap recover`";
            Err(wrong(path, &format!("{}: {}; {fix}", problem.subject, problem.detail)))
        }
        None => Ok(()),
    }
}

fn check_order(path: &Path, times: Times, before: &Path, earlier: Times) -> Result<(), RecordingError> {
    let Times(first, last) = times;
    if last > earlier.1 && first.saturating_add(OVERLAP) >= earlier.1 {
        return Ok(());
    }
    let problem = format!(
        "it overlaps with {}: it has the time from {} to {} s, and that one ends at {} s; push parts of one recording, each \
         once and in their order",
        before.display(),
        seconds(first),
        seconds(last),
        seconds(earlier.1)
    );
    Err(wrong(path, &problem))
}

/// Seconds with milliseconds.
fn seconds(nanoseconds: u64) -> String {
    format!("{}.{:03}", nanoseconds / 1_000_000_000, nanoseconds / 1_000_000 % 1000)
}

fn wrong(path: &Path, problem: &str) -> RecordingError {
    RecordingError::Part { path: path.to_owned(), problem: problem.to_owned() }
}

/// The summary section that was written.
fn summarized(written: &mcap::Summary) -> Option<RecordingSummary> {
    let statistics = written.stats.as_ref()?;
    let mut topics = BTreeMap::new();
    for (channel, count) in &statistics.channel_message_counts {
        *topics.entry(written.channels.get(channel)?.topic.clone()).or_default() += count;
    }
    let chunks = written.chunk_indexes.iter().map(|chunk| chunk.chunk_length.max(chunk.uncompressed_size));
    Some(RecordingSummary {
        duration_ns: statistics.message_end_time.saturating_sub(statistics.message_start_time),
        messages: statistics.message_count,
        channels: statistics.channel_count.into(),
        schemas: statistics.schema_count.into(),
        largest_chunk_bytes: chunks.max().unwrap_or_default(),
        topics,
    })
}

#[cfg(test)]
mod tests;
