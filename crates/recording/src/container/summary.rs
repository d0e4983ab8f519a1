//! The summary section at the end of a file, read without the data before it.
//!
//! Its numbers are statements: a file whose summary is absent, damaged or contradicts itself has none here. Memory follows
//! the channels and the largest record of the section.

use std::collections::BTreeMap;
use std::path::Path;

use mcap::records::op;

use super::frames::{Frames, HEAD_BYTES};
use super::index::{ChunkIndex, Footer, Statistics};
use super::record::{self, Record};
use crate::error::RecordingError;
use gleaner_core::RecordingSummary;

/// Reads the summary section of a file; `None` where there is no whole and consistent one.
///
/// # Errors
/// [`RecordingError::Io`], `Empty` and `NotMcap`.
pub(crate) fn summary(path: &Path) -> Result<Option<RecordingSummary>, RecordingError> {
    let mut frames = Frames::open(path)?;
    let tail = HEAD_BYTES as u64 + Footer::BYTES + mcap::MAGIC.len() as u64;
    let Some(end) = frames.size.checked_sub(tail) else { return Ok(None) };
    let Some(footer) = footer(&mut frames, end)? else { return Ok(None) };
    if !(Frames::begin()..end).contains(&footer.summary_start) {
        return Ok(None);
    }
    frames.seek(footer.summary_start)?;
    let mut stated = Stated::default();
    while frames.offset < end {
        let Some(frame) = frames.next()?.filter(|frame| frame.length <= end.saturating_sub(frames.offset)) else {
            return Ok(None);
        };
        frames.include(&frame);
        let mut body = Vec::new();
        if !frames.body(frame.length, &mut body)? || stated.add(frame.opcode, &body).is_none() {
            return Ok(None);
        }
    }
    // The checksum of the section includes the footer up to the checksum itself.
    let Some(frame) = frames.next()?.filter(|_| frames.offset == end + HEAD_BYTES as u64) else { return Ok(None) };
    frames.include(&frame);
    frames.body(Footer::CHECKED_BYTES, &mut Vec::new())?;
    let sound = footer.checksum == 0 || footer.checksum == frames.checksum();
    Ok(if sound { stated.summary() } else { None })
}

/// The footer at this offset.
fn footer(frames: &mut Frames, at: u64) -> Result<Option<Footer>, RecordingError> {
    frames.seek(at)?;
    let mut body = Vec::new();
    let Some(frame) = frames.next()? else { return Ok(None) };
    if (frame.opcode, frame.length) != (op::FOOTER, Footer::BYTES) || !frames.body(frame.length, &mut body)? {
        return Ok(None);
    }
    let whole = frames.magic()?;
    Ok(Footer::parse(&body).filter(|footer| whole && footer.summary_start > 0))
}

/// The records of a summary section.
#[derive(Default)]
struct Stated {
    statistics: Option<Statistics>,
    /// The topic of each channel.
    topics: BTreeMap<u16, String>,
    largest_chunk_bytes: u64,
}

impl Stated {
    /// Adds a record; `None` if its fields do not fit its length.
    fn add(&mut self, opcode: u8, body: &[u8]) -> Option<()> {
        match opcode {
            op::STATISTICS => self.statistics = Some(Statistics::parse(body)?),
            op::CHUNK_INDEX => {
                self.largest_chunk_bytes = self.largest_chunk_bytes.max(ChunkIndex::parse(body)?.chunk_bytes);
            }
            op::CHANNEL => {
                if let Some(Record::Channel { id, topic, .. }) = record::parse(opcode, body).ok()? {
                    self.topics.insert(id, topic.to_owned());
                }
            }
            _ => {}
        }
        Some(())
    }

    /// `None` without statistics, or if their numbers contradict each other.
    fn summary(self) -> Option<RecordingSummary> {
        let Statistics { messages, schemas, channels, times: (first, last), channel_messages, .. } = self.statistics?;
        let counted = channel_messages.values().try_fold(0_u64, |sum, count| sum.checked_add(*count))?;
        if counted != messages {
            return None;
        }
        let mut topics = BTreeMap::new();
        for (channel, count) in channel_messages {
            if let Some(topic) = self.topics.get(&channel) {
                *topics.entry(topic.clone()).or_default() += count;
            }
        }
        let (duration_ns, largest_chunk_bytes) = (last.checked_sub(first)?, self.largest_chunk_bytes);
        Some(RecordingSummary { duration_ns, messages, channels, schemas, largest_chunk_bytes, topics })
    }
}

#[cfg(test)]
mod tests {
    use mcap::records::MessageHeader;

    use super::*;

    /// A file of 10 messages on one topic and 5 on another, 100 ns apart.
    fn file(options: mcap::WriteOptions) -> Vec<u8> {
        let mut writer = options.create(std::io::Cursor::new(Vec::new())).unwrap();
        let schema = writer.add_schema("s", "jsonschema", b"{}").unwrap();
        let channels = ["/a", "/b"].map(|topic| writer.add_channel(schema, topic, "json", &BTreeMap::new()).unwrap());
        for at in 0..15_u32 {
            let time = 1000 + u64::from(at) * 100;
            let channel_id = channels[usize::from(at % 3 == 2)];
            let header = MessageHeader { channel_id, sequence: at, log_time: time, publish_time: time };
            writer.write_to_known_channel(&header, &[b' '; 40]).unwrap();
        }
        writer.finish().unwrap();
        writer.into_inner().into_inner()
    }

    fn read(bytes: &[u8]) -> Result<Option<RecordingSummary>, RecordingError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        std::fs::write(&path, bytes).unwrap();
        summary(&path)
    }

    #[test]
    fn statistics_channels_and_chunks_are_read_from_the_end() {
        let plain = mcap::WriteOptions::new().compression(None).chunk_size(Some(200));
        let found = read(&file(plain)).unwrap().unwrap();
        let topics = BTreeMap::from([("/a".to_owned(), 10), ("/b".to_owned(), 5)]);
        assert_eq!((found.messages, found.channels, found.schemas), (15, 2, 1));
        assert_eq!((found.duration_ns, found.topics), (1400, topics));
        assert!((200..400).contains(&found.largest_chunk_bytes), "{}", found.largest_chunk_bytes);
        let packed = read(&file(mcap::WriteOptions::new())).unwrap().unwrap();
        assert!(packed.largest_chunk_bytes > 15 * 40, "the unpacked size counts: {}", packed.largest_chunk_bytes);
        let unchunked = read(&file(mcap::WriteOptions::new().use_chunks(false))).unwrap().unwrap();
        assert_eq!((unchunked.largest_chunk_bytes, unchunked.messages), (0, 15));
    }

    #[test]
    fn files_without_a_sound_summary_have_none() {
        let whole = file(mcap::WriteOptions::new());
        for cut in 8..whole.len() {
            assert_eq!(read(&whole[..cut]).unwrap(), None, "cut at {cut}");
        }
        let without = mcap::WriteOptions::new().emit_summary_records(false).emit_summary_offsets(false);
        assert_eq!(read(&file(without)).unwrap(), None);
        assert!(matches!(read(b""), Err(RecordingError::Empty { .. })));
        assert!(matches!(read(b"not a recording at all"), Err(RecordingError::NotMcap { .. })));
    }

    #[test]
    fn changed_bytes_of_the_summary_are_noticed() {
        let whole = file(mcap::WriteOptions::new());
        let sound = read(&whole).unwrap();
        let start = whole.len() - 8 - 20;
        let start = u64::from_le_bytes(whole[start..start + 8].try_into().unwrap());
        for at in usize::try_from(start).unwrap()..whole.len() {
            for bit in [0x01, 0x80] {
                let mut changed = whole.clone();
                changed[at] ^= bit;
                assert!(read(&changed).unwrap().is_none_or(|found| Some(found) == sound), "byte {at}");
            }
        }
    }
}
