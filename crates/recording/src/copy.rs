//! Copies records of a recording into another one without changes; the caller selects the messages.

use std::collections::HashMap;
use std::io::{Seek, Write};

use mcap::records::{MessageHeader, Metadata};

use crate::container::Record;
use crate::error::RecordingError;

/// A recording that is being written from another one's records.
pub(crate) struct Copier<W: Write + Seek> {
    pub(crate) writer: mcap::Writer<W>,
    /// Identifiers in the source to identifiers in the copy.
    schemas: HashMap<u16, u16>,
    channels: HashMap<u16, u16>,
}

impl<W: Write + Seek> Copier<W> {
    pub(crate) fn new(writer: mcap::Writer<W>) -> Self {
        Self { writer, schemas: HashMap::new(), channels: HashMap::new() }
    }

    /// Drops the identifiers of the source: the next records are those of another one. Equal schemas and channels have
    /// the same identifier in the copy.
    pub(crate) fn next_source(&mut self) {
        self.schemas.clear();
        self.channels.clear();
    }

    /// Whether messages of this channel of the source can be copied.
    pub(crate) fn declares(&self, channel: u16) -> bool {
        self.channels.contains_key(&channel)
    }

    /// Copies a schema, a channel or metadata.
    pub(crate) fn declare(&mut self, record: &Record<'_>) -> Result<(), RecordingError> {
        match record {
            Record::Schema { id, name, encoding, data } if !self.schemas.contains_key(id) => {
                let copied = self.writer.add_schema(name, encoding, data).map_err(RecordingError::Write)?;
                self.schemas.insert(*id, copied);
            }
            Record::Channel { id, schema_id, topic, encoding, metadata } if !self.channels.contains_key(id) => {
                let schema = self.schemas.get(schema_id).copied().unwrap_or_default();
                let copied =
                    self.writer.add_channel(schema, topic, encoding, metadata).map_err(RecordingError::Write)?;
                self.channels.insert(*id, copied);
            }
            Record::Metadata { name, values } => {
                let metadata = Metadata { name: (*name).to_owned(), metadata: values.clone() };
                self.writer.write_metadata(&metadata).map_err(RecordingError::Write)?;
            }
            Record::Schema { .. }
            | Record::Channel { .. }
            | Record::Header { .. }
            | Record::Message { .. }
            | Record::Attachment { .. } => {}
        }
        Ok(())
    }

    /// Copies a message; one of an undeclared channel is omitted.
    pub(crate) fn message(&mut self, header: MessageHeader, data: &[u8]) -> Result<(), RecordingError> {
        let Some(&channel_id) = self.channels.get(&header.channel_id) else { return Ok(()) };
        self.writer.write_to_known_channel(&MessageHeader { channel_id, ..header }, data).map_err(RecordingError::Write)
    }

    /// Ends the copy.
    pub(crate) fn finish(mut self) -> Result<W, RecordingError> {
        self.writer.finish().map_err(RecordingError::Write)?;
        Ok(self.writer.into_inner())
    }
}
