//! The bodies of the records that describe a file rather than hold its data: chunk headers, indexes, statistics, and
//! the ends of the two sections.

use std::collections::BTreeMap;
use std::hash::{DefaultHasher, Hash, Hasher};

use mcap::records::op;

use super::record::Fields;

/// The header of a chunk.
#[derive(Clone, Debug)]
pub(super) struct ChunkHead {
    pub(super) start_time: u64,
    pub(super) end_time: u64,
    pub(super) uncompressed_size: u64,
    /// 0 when the writer calculated none.
    pub(super) checksum: u32,
    pub(super) compression: String,
    pub(super) compressed_size: u64,
}

/// The fields of a chunk index, which describes one chunk.
#[derive(Debug)]
pub(super) struct ChunkIndex {
    /// The [`chunk_key`] of the chunk.
    pub(super) chunk: u64,
    /// The offset of the chunk's message index of each channel.
    pub(super) offsets: BTreeMap<u16, u64>,
    /// Bytes of all message indexes of the chunk.
    pub(super) length: u64,
    /// Bytes of the chunk, as it is stored or as it unpacks: the larger number.
    pub(super) chunk_bytes: u64,
}

/// The counts that a file states about itself.
#[derive(Debug)]
pub(super) struct Statistics {
    pub(super) messages: u64,
    pub(super) schemas: u64,
    pub(super) channels: u64,
    pub(super) attachments: u64,
    pub(super) metadata: u64,
    pub(super) chunks: u64,
    /// Log times of the first and the last message.
    pub(super) times: (u64, u64),
    pub(super) channel_messages: BTreeMap<u16, u64>,
}

/// The end of a file.
#[derive(Debug)]
pub(super) struct Footer {
    pub(super) summary_start: u64,
    pub(super) summary_offset_start: u64,
    /// 0 when the writer calculated none.
    pub(super) checksum: u32,
}

/// Messages in any order: their number, and a sum over their times and places.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Entries {
    pub(super) count: u64,
    sum: u64,
}

impl Entries {
    pub(super) fn add(&mut self, time: u64, offset: u64) {
        self.count += 1;
        self.sum = self.sum.wrapping_add(hash((time, offset)));
    }
}

/// The messages of one chunk.
#[derive(Debug, Default)]
pub(super) struct Messages {
    pub(super) of_channels: BTreeMap<u16, Entries>,
    /// Earliest and latest log time.
    pub(super) times: Option<(u64, u64)>,
}

impl Messages {
    pub(super) fn add(&mut self, channel: u16, log_time: u64, offset: u64) {
        self.of_channels.entry(channel).or_default().add(log_time, offset);
        let (first, last) = self.times.unwrap_or((log_time, log_time));
        self.times = Some((first.min(log_time), last.max(log_time)));
    }
}

impl ChunkHead {
    /// Bytes before the name of the compression.
    pub(super) const FIXED_BYTES: u64 = 32;

    /// Bytes of the compression's name, which the last of the fixed fields claims.
    pub(super) fn name_bytes(fixed: &[u8]) -> u64 {
        fixed.last_chunk().copied().map(u32::from_le_bytes).unwrap_or_default().into()
    }

    pub(super) fn parse(body: &[u8]) -> Option<Self> {
        let mut fields = Fields { rest: body };
        Some(Self {
            start_time: fields.u64()?,
            end_time: fields.u64()?,
            uncompressed_size: fields.u64()?,
            checksum: fields.u32()?,
            compression: fields.text()?.to_owned(),
            compressed_size: fields.u64()?,
        })
    }
}

impl ChunkIndex {
    pub(super) fn parse(body: &[u8]) -> Option<Self> {
        let mut fields = Fields { rest: body };
        let (start_time, end_time, offset, length) = (fields.u64()?, fields.u64()?, fields.u64()?, fields.u64()?);
        let (offsets, index_length) = (fields.counts()?, fields.u64()?);
        let compression = fields.text()?.to_owned();
        let (compressed_size, uncompressed_size) = (fields.u64()?, fields.u64()?);
        let head = ChunkHead { start_time, end_time, uncompressed_size, checksum: 0, compression, compressed_size };
        let chunk_bytes = compressed_size.max(uncompressed_size);
        Some(Self { chunk: chunk_key(offset, length, &head), offsets, length: index_length, chunk_bytes })
    }
}

impl Statistics {
    pub(super) fn parse(body: &[u8]) -> Option<Self> {
        let mut fields = Fields { rest: body };
        Some(Self {
            messages: fields.u64()?,
            schemas: fields.u16()?.into(),
            channels: fields.u32()?.into(),
            attachments: fields.u32()?.into(),
            metadata: fields.u32()?.into(),
            chunks: fields.u32()?.into(),
            times: (fields.u64()?, fields.u64()?),
            channel_messages: fields.counts()?,
        })
    }
}

impl Footer {
    /// Bytes before the checksum, which are a part of it.
    pub(super) const CHECKED_BYTES: u64 = 16;
    /// Bytes of the whole body.
    pub(super) const BYTES: u64 = Self::CHECKED_BYTES + 4;

    pub(super) fn parse(body: &[u8]) -> Option<Self> {
        let mut fields = Fields { rest: body };
        Some(Self { summary_start: fields.u64()?, summary_offset_start: fields.u64()?, checksum: fields.u32()? })
    }
}

/// The channel of a message index, and its entries.
pub(super) fn message_index(body: &[u8]) -> Option<(u16, Entries)> {
    let mut fields = Fields { rest: body };
    let channel = fields.u16()?;
    let mut list = Fields { rest: fields.bytes()? };
    let mut entries = Entries::default();
    while !list.rest.is_empty() {
        entries.add(list.u64()?, list.u64()?);
    }
    Some((channel, entries))
}

/// Whether an attachment matches its checksum; `None` if its fields do not fit its length.
pub(super) fn attachment(body: &[u8]) -> Option<bool> {
    let mut fields = Fields { rest: body };
    let (_log_time, _creation_time) = (fields.u64()?, fields.u64()?);
    let (_name, _media_type, _contents) = (fields.text()?, fields.text()?, fields.long_bytes()?);
    let (content, stored) = body.split_last_chunk()?;
    let stored = u32::from_le_bytes(*stored);
    (fields.rest.len() == size_of::<u32>()).then(|| stored == 0 || stored == crc32fast::hash(content))
}

/// Whether the fields of a record that names places in the file fit its length.
pub(super) fn fits(opcode: u8, body: &[u8]) -> bool {
    let mut fields = Fields { rest: body };
    let mut numbers = |count: usize| (0..count).try_for_each(|_| fields.u64().map(|_| ()));
    match opcode {
        // Offset, length, log time, creation time, size; then name and media type.
        op::ATTACHMENT_INDEX => numbers(5).and_then(|()| fields.text()).and_then(|_| fields.text()).is_some(),
        // Offset and length; then the name.
        op::METADATA_INDEX => numbers(2).and_then(|()| fields.text()).is_some(),
        // The kind of the records; then where they begin and their length.
        op::SUMMARY_OFFSET => body.len() > 2 * size_of::<u64>(),
        _ => true,
    }
}

/// The checksum that ends the data section; 0 if the writer calculated none.
pub(super) fn data_end(body: &[u8]) -> Option<u32> {
    Fields { rest: body }.u32()
}

/// A number for a chunk, the same from the chunk itself and from its index.
pub(super) fn chunk_key(offset: u64, length: u64, head: &ChunkHead) -> u64 {
    let sizes = (head.compressed_size, head.uncompressed_size);
    hash((offset, length, head.start_time, head.end_time, &head.compression, sizes))
}

fn hash(of: impl Hash) -> u64 {
    let mut hasher = DefaultHasher::new();
    of.hash(&mut hasher);
    hasher.finish()
}
