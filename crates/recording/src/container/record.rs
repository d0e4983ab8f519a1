//! The bodies of the used records, parsed here, because the `mcap` crate reserves memory for a string before it has read
//! the string.

use std::collections::BTreeMap;

use mcap::records::{MessageHeader, op};

use crate::error::RecordingError;

/// A record that this crate uses.
#[derive(Debug)]
pub(crate) enum Record<'a> {
    Header { profile: &'a str },
    Schema { id: u16, name: &'a str, encoding: &'a str, data: &'a [u8] },
    Channel { id: u16, schema_id: u16, topic: &'a str, encoding: &'a str, metadata: BTreeMap<String, String> },
    Message { header: MessageHeader, data: &'a [u8] },
    Metadata { name: &'a str, values: BTreeMap<String, String> },
    Attachment { log_time: u64, create_time: u64, name: &'a str, media_type: &'a str, data: &'a [u8] },
}

/// Parses the body of a record; `None` for an unused kind.
pub(super) fn parse(opcode: u8, body: &[u8]) -> Result<Option<Record<'_>>, RecordingError> {
    let mut fields = Fields { rest: body };
    let record = match opcode {
        // The writer's library follows.
        op::HEADER => fields.text().zip(fields.text()).map(|(profile, _)| Record::Header { profile }),
        op::SCHEMA => fields.schema(),
        op::CHANNEL => fields.channel(),
        op::MESSAGE => fields.message(),
        op::METADATA => fields.metadata(),
        op::ATTACHMENT => fields.attachment(),
        _ => return Ok(None),
    };
    record.map(Some).ok_or_else(|| unfit(opcode))
}

/// For a record whose fields do not fit its length.
pub(super) fn unfit(opcode: u8) -> RecordingError {
    let problem = format!("a record of kind {opcode:#04x} does not fit its length; record or copy the file again");
    RecordingError::Damaged { problem }
}

/// The fields of a record's body, read from the front; `None` once they do not fit.
pub(super) struct Fields<'a> {
    pub(super) rest: &'a [u8],
}

impl<'a> Fields<'a> {
    fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (head, rest) = self.rest.split_first_chunk()?;
        self.rest = rest;
        Some(*head)
    }

    pub(super) fn u16(&mut self) -> Option<u16> {
        self.array().map(u16::from_le_bytes)
    }

    pub(super) fn u32(&mut self) -> Option<u32> {
        self.array().map(u32::from_le_bytes)
    }

    pub(super) fn u64(&mut self) -> Option<u64> {
        self.array().map(u64::from_le_bytes)
    }

    pub(super) fn bytes(&mut self) -> Option<&'a [u8]> {
        let length = usize::try_from(self.u32()?).ok()?;
        let (head, rest) = self.rest.split_at_checked(length)?;
        self.rest = rest;
        Some(head)
    }

    /// Bytes whose length is a number of 64 bits.
    pub(super) fn long_bytes(&mut self) -> Option<&'a [u8]> {
        let length = usize::try_from(self.u64()?).ok()?;
        let (head, rest) = self.rest.split_at_checked(length)?;
        self.rest = rest;
        Some(head)
    }

    pub(super) fn text(&mut self) -> Option<&'a str> {
        std::str::from_utf8(self.bytes()?).ok()
    }

    fn map(&mut self) -> Option<BTreeMap<String, String>> {
        let mut inner = Fields { rest: self.bytes()? };
        let mut map = BTreeMap::new();
        while !inner.rest.is_empty() {
            map.insert(inner.text()?.to_owned(), inner.text()?.to_owned());
        }
        Some(map)
    }

    /// A map from identifiers to numbers.
    pub(super) fn counts(&mut self) -> Option<BTreeMap<u16, u64>> {
        let mut inner = Fields { rest: self.bytes()? };
        let mut counts = BTreeMap::new();
        while !inner.rest.is_empty() {
            counts.insert(inner.u16()?, inner.u64()?);
        }
        Some(counts)
    }

    fn schema(&mut self) -> Option<Record<'a>> {
        Some(Record::Schema { id: self.u16()?, name: self.text()?, encoding: self.text()?, data: self.bytes()? })
    }

    fn channel(&mut self) -> Option<Record<'a>> {
        Some(Record::Channel {
            id: self.u16()?,
            schema_id: self.u16()?,
            topic: self.text()?,
            encoding: self.text()?,
            metadata: self.map()?,
        })
    }

    fn message(&mut self) -> Option<Record<'a>> {
        let header = MessageHeader {
            channel_id: self.u16()?,
            sequence: self.u32()?,
            log_time: self.u64()?,
            publish_time: self.u64()?,
        };
        Some(Record::Message { header, data: self.rest })
    }

    fn metadata(&mut self) -> Option<Record<'a>> {
        Some(Record::Metadata { name: self.text()?, values: self.map()? })
    }

    /// Without the checksum at its end.
    fn attachment(&mut self) -> Option<Record<'a>> {
        Some(Record::Attachment {
            log_time: self.u64()?,
            create_time: self.u64()?,
            name: self.text()?,
            media_type: self.text()?,
            data: self.long_bytes()?,
        })
    }
}
