//! The MCAP container: a file's records in order, with every length checked.
//!
//! Records are read one at a time, so memory follows the largest record, not the file. The checksums, statistics and
//! indexes of the file are compared with its records on the way. Independent of dialects and tasks.

mod chunks;
mod frames;
mod index;
mod integrity;
mod record;
mod record_limits;
mod statistics;
mod summary;

use std::path::Path;

use mcap::records::op;

use crate::error::RecordingError;
use crate::limits::Limits;
use frames::{Frame, Frames};
use index::{ChunkIndex, Footer, Messages, Statistics};
use integrity::Integrity;
use record_limits::{check_names, check_size};

pub(crate) use integrity::Problem;
pub(crate) use record::Record;
pub(crate) use summary::summary;

/// The end of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Ending {
    /// At the closing magic bytes.
    Whole,
    /// In the middle; every record before the cut was visited.
    Cut,
}

/// A file whose records were all visited.
#[derive(Debug)]
pub(crate) struct Scanned {
    pub(crate) ending: Ending,
    /// The contradictions of the file.
    pub(crate) problems: Vec<Problem>,
}

/// Receives a record.
type Visit<'a> = &'a mut dyn FnMut(Record<'_>) -> Result<(), RecordingError>;

/// Calls `visit` with every record of the file, in the order of the file.
///
/// # Errors
/// The errors of `visit`; [`RecordingError::Io`], `Empty`, `NotMcap`, `TooLarge` and `Damaged`.
pub(crate) fn scan(path: &Path, limits: &Limits, visit: Visit<'_>) -> Result<Scanned, RecordingError> {
    Scan::open(path, limits, false)?.run(visit)
}

/// Like [`scan`], but a chunk is visited only if it is complete and matches its checksum, for a salvage of a damaged
/// file.
///
/// # Errors
/// Like [`scan`].
pub(crate) fn scan_whole_chunks(path: &Path, limits: &Limits, visit: Visit<'_>) -> Result<Scanned, RecordingError> {
    Scan::open(path, limits, true)?.run(visit)
}

/// The place of a record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Place {
    /// In a chunk; whether the chunk has a checksum.
    Chunk { checked: bool },
    /// In the data section, outside of chunks.
    Data,
    /// Between the end of the data section and the footer.
    Summary,
}

/// One pass over a file.
struct Scan<'a> {
    frames: Frames,
    integrity: Integrity,
    limits: &'a Limits,
    whole_chunks: bool,
    /// Records so far, those in chunks among them.
    records: u64,
    /// The offset of the summary offsets.
    summary_offsets: Option<u64>,
    section: Place,
    body: Vec<u8>,
}

/// Whether the pass continues.
enum Next {
    More,
    End(Ending),
}

impl<'a> Scan<'a> {
    fn open(path: &Path, limits: &'a Limits, whole_chunks: bool) -> Result<Self, RecordingError> {
        Ok(Self {
            frames: Frames::open(path)?,
            integrity: Integrity::default(),
            limits,
            whole_chunks,
            records: 0,
            summary_offsets: None,
            section: Place::Data,
            body: Vec::new(),
        })
    }

    fn run(mut self, visit: Visit<'_>) -> Result<Scanned, RecordingError> {
        loop {
            let next = match self.frames.next()? {
                Some(frame) => self.frame(&frame, visit)?,
                None => Next::End(Ending::Cut),
            };
            if let Next::End(ending) = next {
                let problems = self.integrity.finish(ending == Ending::Whole);
                return Ok(Scanned { ending, problems });
            }
        }
    }

    fn frame(&mut self, frame: &Frame, visit: Visit<'_>) -> Result<Next, RecordingError> {
        if frame.length > self.limits.chunk_bytes as u64 {
            let problem = format!(
                "a record of kind {:#04x} claims {} bytes; a chunk may have {} bytes, packed and unpacked, so the file is \
                 damaged or of another kind",
                frame.opcode, frame.length, self.limits.chunk_bytes
            );
            return Err(RecordingError::TooLarge { problem });
        }
        if frame.opcode != op::MESSAGE_INDEX {
            self.integrity.close_chunk();
        }
        match frame.opcode {
            op::CHUNK => self.chunk(frame, visit),
            op::DATA_END => self.data_end(frame),
            op::FOOTER => self.footer(frame),
            _ => self.other(frame, visit),
        }
    }

    fn chunk(&mut self, frame: &Frame, visit: Visit<'_>) -> Result<Next, RecordingError> {
        self.frames.include(frame);
        let (mut messages, limits) = (Messages::default(), self.limits);
        let (records, integrity) = (&mut self.records, &mut self.integrity);
        let head =
            chunks::read(&mut self.frames, frame, limits, self.whole_chunks, &mut |checked, opcode, data, at| {
                *records += 1;
                check_size(*records, data.len(), limits)?;
                if let Some(record) = record::parse(opcode, data)? {
                    check_names(&record, limits)?;
                    integrity.record(&record, Place::Chunk { checked });
                    if let Record::Message { header, .. } = &record {
                        messages.add(header.channel_id, header.log_time, at);
                    }
                    visit(record)?;
                }
                Ok(())
            })?;
        let Some(head) = head else { return Ok(Next::End(Ending::Cut)) };
        self.integrity.chunk(frame, &head, messages);
        Ok(Next::More)
    }

    fn data_end(&mut self, frame: &Frame) -> Result<Next, RecordingError> {
        let calculated = self.frames.checksum();
        let Some(body) = self.body(frame)? else { return Ok(Next::End(Ending::Cut)) };
        let stored = index::data_end(body).ok_or_else(|| record::unfit(frame.opcode))?;
        // The summary's checksum begins after this record.
        self.frames.checksum();
        self.section = Place::Summary;
        if self.integrity.data_end((stored, calculated), self.frames.offset) {
            return Ok(Next::More);
        }
        let problem = format!(
            "the checksum of the data section is {stored:#010x} and its bytes give {calculated:#010x}, so some of its values \
             are changed or lost; record or copy the file again"
        );
        Err(RecordingError::Damaged { problem })
    }

    fn footer(&mut self, frame: &Frame) -> Result<Next, RecordingError> {
        self.frames.include(frame);
        let mut body = Vec::new();
        let checked = Footer::CHECKED_BYTES.min(frame.length);
        if !self.frames.body(checked, &mut body)? {
            return Ok(Next::End(Ending::Cut));
        }
        let calculated = self.frames.checksum();
        if !self.frames.body(frame.length - checked, &mut self.body)? {
            return Ok(Next::End(Ending::Cut));
        }
        body.append(&mut self.body);
        let footer = Footer::parse(&body).ok_or_else(|| record::unfit(frame.opcode))?;
        self.integrity.footer(&footer, frame.offset, calculated, self.summary_offsets);
        // Other closing bytes than the magic are a cut too: all records have been read by then.
        if !self.frames.magic()? {
            return Ok(Next::End(Ending::Cut));
        }
        let rest = self.frames.size.saturating_sub(self.frames.offset);
        if rest > 0 {
            self.integrity.trailing(rest);
        }
        Ok(Next::End(Ending::Whole))
    }

    fn other(&mut self, frame: &Frame, visit: Visit<'_>) -> Result<Next, RecordingError> {
        self.frames.include(frame);
        let whole = if is_read(frame.opcode) { self.body(frame)?.is_some() } else { self.skip(frame)? };
        if !whole {
            return Ok(Next::End(Ending::Cut));
        }
        match frame.opcode {
            op::MESSAGE_INDEX => self.integrity.message_index(frame, index::message_index(&self.body)),
            op::CHUNK_INDEX => self.integrity.chunk_index(ChunkIndex::parse(&self.body)),
            op::STATISTICS => self.integrity.statistics(Statistics::parse(&self.body)),
            op::ATTACHMENT => {
                self.integrity.attachment(index::attachment(&self.body));
                // One that does not fit its length is a problem of the file, which is read without it.
                if let Ok(Some(record)) = record::parse(op::ATTACHMENT, &self.body) {
                    visit(record)?;
                }
            }
            op::ATTACHMENT_INDEX | op::METADATA_INDEX | op::SUMMARY_OFFSET => {
                self.integrity.places(index::fits(frame.opcode, &self.body));
            }
            opcode if is_read(opcode) => {
                if let Some(record) = record::parse(opcode, &self.body)? {
                    check_names(&record, self.limits)?;
                    self.integrity.record(&record, self.section);
                    visit(record)?;
                }
            }
            _ => {}
        }
        if frame.opcode == op::SUMMARY_OFFSET {
            self.summary_offsets.get_or_insert(frame.offset);
        }
        Ok(Next::More)
    }

    /// Skips a record's body; false if the file ends in it.
    fn skip(&mut self, frame: &Frame) -> Result<bool, RecordingError> {
        self.records += 1;
        check_size(self.records, usize::try_from(frame.length).unwrap_or(usize::MAX), self.limits)?;
        self.frames.skip(frame.length)
    }

    /// The record's body; `None` if the file ends in it.
    fn body(&mut self, frame: &Frame) -> Result<Option<&[u8]>, RecordingError> {
        let whole = self.frames.body(frame.length, &mut self.body)?;
        self.records += 1;
        check_size(self.records, self.body.len(), self.limits)?;
        Ok(whole.then_some(self.body.as_slice()))
    }
}

/// Whether the format defines the contents of such a record. Readers skip the others.
fn is_read(opcode: u8) -> bool {
    (op::HEADER..=op::DATA_END).contains(&opcode)
}

#[cfg(test)]
mod tests;
