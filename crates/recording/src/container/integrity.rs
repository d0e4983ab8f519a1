//! Compares the checksums, statistics, indexes and footer of a file with its records, and finds bytes after its end.
//!
//! Memory follows the number of chunks and channels, not of messages: the messages of a chunk are compared with their
//! index as sums.

use std::collections::{BTreeMap, HashMap};
use std::hash::{DefaultHasher, Hash, Hasher};

use super::frames::Frame;
use super::index::{ChunkHead, ChunkIndex, Entries, Footer, Messages, Statistics, chunk_key};
use super::statistics::Counts;
use super::{Place, Record};
use gleaner_core::FindingCode;

/// A contradiction in a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Problem {
    pub(crate) code: FindingCode,
    /// The part of the file that is contradicted.
    pub(crate) subject: &'static str,
    pub(crate) detail: String,
}

/// The messages of the chunk whose message indexes are being read.
struct OpenChunk {
    key: u64,
    messages: BTreeMap<u16, Entries>,
    indexed: BTreeMap<u16, Entries>,
    /// The offset of each channel's message index.
    offsets: BTreeMap<u16, u64>,
    index_bytes: u64,
}

/// The parts of a file that have been read so far.
#[derive(Default)]
pub(super) struct Integrity {
    counts: Counts,
    /// Schemas, channels and messages outside of chunks that have a checksum.
    unchecked: u64,
    /// The declaration of each identifier of a schema (true) or channel.
    declared: HashMap<(bool, u16), u64>,
    open: Option<OpenChunk>,
    /// The places and the length of the message indexes of each chunk without a chunk index so far.
    chunks: HashMap<u64, (BTreeMap<u16, u64>, u64)>,
    chunk_indexes: u64,
    statistics: Option<Statistics>,
    /// The offset of the summary section.
    summary_start: Option<u64>,
    problems: Vec<Problem>,
}

impl Integrity {
    /// Adds a parsed record.
    pub(super) fn record(&mut self, record: &Record<'_>, place: Place) {
        let checked = matches!(place, Place::Chunk { checked: true });
        let declaration = match record {
            Record::Schema { id, name, encoding, data } => {
                self.counts.schema(*id, place);
                Some((("schema", true, *id), hash((name, encoding, data))))
            }
            Record::Channel { id, schema_id, topic, encoding, metadata } => {
                self.counts.channel(*id, place);
                Some((("channel", false, *id), hash((schema_id, topic, encoding, metadata))))
            }
            Record::Message { header, .. } => {
                self.counts.message(header.channel_id, header.log_time);
                if place == Place::Summary {
                    self.add(FindingCode::SummaryMismatch, "data section", "messages lie after its end".to_owned());
                }
                None
            }
            Record::Metadata { .. } if place == Place::Data => {
                self.counts.metadata += 1;
                return;
            }
            Record::Header { .. } | Record::Metadata { .. } | Record::Attachment { .. } => return,
        };
        self.unchecked += u64::from(!checked && place != Place::Summary);
        let Some(((kind, is_schema, id), content)) = declaration else { return };
        if *self.declared.entry((is_schema, id)).or_insert(content) != content {
            let detail = format!("{kind} {id} is declared twice with different contents; the first one was used");
            self.add(FindingCode::ConflictingDeclaration, "file", detail);
        }
    }

    /// Adds an attachment: whether its checksum is right; `None` if its fields do not fit its length.
    pub(super) fn attachment(&mut self, right: Option<bool>) {
        self.counts.attachments += 1;
        match right {
            Some(true) => {}
            Some(false) => {
                let detail =
                    "the checksum of an attachment differs from its bytes; steps do not use attachments".to_owned();
                self.add(FindingCode::ChecksumMismatch, "attachments", detail);
            }
            None => self.unfit("attachments"),
        }
    }

    /// Adds a record that names places in the file: whether its fields fit its length.
    pub(super) fn places(&mut self, fits: bool) {
        if !fits {
            self.unfit("summary section");
        }
    }

    /// Adds a chunk and its messages.
    pub(super) fn chunk(&mut self, frame: &Frame, head: &ChunkHead, messages: Messages) {
        self.counts.chunks += 1;
        if self.summary_start.is_some() {
            self.add(FindingCode::SummaryMismatch, "data section", "a chunk lies after its end".to_owned());
        }
        if messages.times.unwrap_or_default() != (head.start_time, head.end_time) {
            let detail = format!(
                "the chunk at byte {} has messages of other times than its header states; indexed readers leave some out",
                frame.offset
            );
            self.add(FindingCode::SummaryMismatch, "chunk header", detail);
        }
        self.open = Some(OpenChunk {
            key: chunk_key(frame.offset, record_bytes(frame), head),
            messages: messages.of_channels,
            indexed: BTreeMap::new(),
            offsets: BTreeMap::new(),
            index_bytes: 0,
        });
    }

    /// Adds a message index; `None` if its body does not fit its length.
    pub(super) fn message_index(&mut self, frame: &Frame, index: Option<(u16, Entries)>) {
        let Some((channel, entries)) = index else { return self.unfit("message index") };
        let doubled = self.open.as_mut().is_none_or(|open| {
            open.offsets.insert(channel, frame.offset);
            open.index_bytes += record_bytes(frame);
            open.indexed.insert(channel, entries).is_some()
        });
        if doubled {
            let detail = format!(
                "the index at byte {} does not follow a chunk, or is the second one of its channel in the chunk",
                frame.offset
            );
            self.add(FindingCode::SummaryMismatch, "message index", detail);
        }
    }

    /// Ends the message indexes of a chunk: another kind of record follows.
    pub(super) fn close_chunk(&mut self) {
        let Some(OpenChunk { key, messages, mut indexed, offsets, index_bytes }) = self.open.take() else { return };
        self.chunks.insert(key, (offsets, index_bytes));
        indexed.retain(|_, entries| entries.count > 0);
        if index_bytes > 0 && messages != indexed {
            let count = |of: &BTreeMap<u16, Entries>| of.values().map(|entries| entries.count).sum::<u64>();
            let detail = format!(
                "the indexes of a chunk name {} messages and the chunk has {}, or they name other messages; indexed \
                 readers leave some out",
                count(&indexed),
                count(&messages)
            );
            self.add(FindingCode::SummaryMismatch, "message index", detail);
        }
    }

    /// Adds a chunk index; `None` if its body does not fit its length.
    pub(super) fn chunk_index(&mut self, index: Option<ChunkIndex>) {
        let Some(index) = index else { return self.unfit("chunk index") };
        self.chunk_indexes += 1;
        let problem = match self.chunks.remove(&index.chunk) {
            None => "a chunk that it names is not in the file: chunks are lost, or in another order",
            // Offsets are optional.
            Some(at) if !index.offsets.is_empty() && at != (index.offsets, index.length) => {
                "the message indexes of a chunk are not at the offsets that it states"
            }
            Some(_) => return,
        };
        self.add(FindingCode::SummaryMismatch, "chunk index", format!("{problem}; record or copy the file again"));
    }

    /// Adds the statistics; `None` if their body does not fit its length.
    pub(super) fn statistics(&mut self, statistics: Option<Statistics>) {
        match statistics {
            Some(statistics) => self.statistics = Some(statistics),
            None => self.unfit("statistics"),
        }
    }

    /// Ends the data section. False when its checksum is wrong and no other one vouches for what was read.
    pub(super) fn data_end(&mut self, (stored, calculated): (u32, u32), end: u64) -> bool {
        if self.summary_start.replace(end).is_some() {
            self.add(FindingCode::SummaryMismatch, "data section", "it ends twice".to_owned());
            return true;
        }
        if stored == 0 || stored == calculated {
            return true;
        }
        let detail = format!(
            "its checksum is {stored:#010x} and the bytes give {calculated:#010x}. The chunks' own checksums are right, but \
             something between them is changed or lost; copy the file again"
        );
        self.add(FindingCode::ChecksumMismatch, "data section", detail);
        self.unchecked == 0
    }

    /// Adds the footer: where it begins, the checksum of the summary, and where the summary offsets begin.
    pub(super) fn footer(&mut self, footer: &Footer, begin: u64, calculated: u32, offsets: Option<u64>) {
        if footer.checksum != 0 && footer.checksum != calculated {
            let detail = format!(
                "its checksum is {:#010x} and the bytes give {calculated:#010x}; copy the file again",
                footer.checksum
            );
            self.add(FindingCode::ChecksumMismatch, "summary section", detail);
        }
        let Some(start) = self.summary_start else {
            let detail = "the footer follows without an end of the data section".to_owned();
            self.add(FindingCode::SummaryMismatch, "data section", detail);
            return;
        };
        let start_fits = footer.summary_start == start || (footer.summary_start == 0 && start == begin);
        let offset = footer.summary_offset_start;
        if !start_fits || (offset != 0 && offset != offsets.unwrap_or(begin)) {
            let detail = format!(
                "it states that the summary begins at byte {} and its offsets at byte {offset}; they begin at byte {start} \
                 and byte {}. Indexed readers find no summary, or a part of it",
                footer.summary_start,
                offsets.unwrap_or(begin)
            );
            self.add(FindingCode::SummaryMismatch, "footer", detail);
        }
    }

    pub(super) fn trailing(&mut self, bytes: u64) {
        let detail =
            format!("{bytes} bytes follow its closing magic bytes and were not read; they may be a second file");
        self.add(FindingCode::TrailingBytes, "file", detail);
    }

    /// Every contradiction. Chunks without an index, and message indexes that do not name all of the last chunk, are expected
    /// in a file that was cut, so they do not count there.
    pub(super) fn finish(mut self, whole: bool) -> Vec<Problem> {
        if whole {
            self.close_chunk();
        }
        if whole && self.chunk_indexes > 0 && !self.chunks.is_empty() {
            let detail = format!(
                "it does not name {} of {} chunks, which were read anyway; indexed readers leave them out",
                self.chunks.len(),
                self.counts.chunks
            );
            self.add(FindingCode::SummaryMismatch, "chunk index", detail);
        }
        if whole && self.counts.are_repeated_in_part() {
            let detail = "it lacks schemas or channels of the data section; readers that begin with it fail".to_owned();
            self.add(FindingCode::SummaryMismatch, "summary section", detail);
        }
        if let Some(difference) = self.statistics.take().and_then(|statistics| self.counts.difference(&statistics)) {
            let detail =
                format!("{difference}. Messages may be lost, doubled or on the wrong channel; copy the file again");
            self.add(FindingCode::SummaryMismatch, "statistics", detail);
        }
        self.problems
    }

    fn unfit(&mut self, subject: &'static str) {
        let detail = "a record does not fit its length and was not compared; copy the file again".to_owned();
        self.add(FindingCode::SummaryMismatch, subject, detail);
    }

    /// The first problem of a kind on a subject counts.
    fn add(&mut self, code: FindingCode, subject: &'static str, detail: String) {
        if !self.problems.iter().any(|known| (known.code, known.subject) == (code, subject)) {
            self.problems.push(Problem { code, subject, detail });
        }
    }
}

fn record_bytes(frame: &Frame) -> u64 {
    frame.length.saturating_add(frame.head.len() as u64)
}

fn hash(of: impl Hash) -> u64 {
    let mut hasher = DefaultHasher::new();
    of.hash(&mut hasher);
    hasher.finish()
}
