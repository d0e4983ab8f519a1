//! Schemas and channels that are kept for episodes that begin later.

use std::collections::BTreeMap;

use crate::container::Record;

/// A schema or a channel.
#[derive(Clone, Debug)]
pub(super) enum Declared {
    Schema { id: u16, name: String, encoding: String, data: Vec<u8> },
    Channel { id: u16, schema_id: u16, topic: String, encoding: String, metadata: BTreeMap<String, String> },
}

impl Declared {
    /// `None` for a record that declares nothing.
    pub(super) fn of(record: &Record<'_>) -> Option<Self> {
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

    pub(super) fn record(&self) -> Record<'_> {
        match self {
            Self::Schema { id, name, encoding, data } => Record::Schema { id: *id, name, encoding, data },
            Self::Channel { id, schema_id, topic, encoding, metadata } => {
                Record::Channel { id: *id, schema_id: *schema_id, topic, encoding, metadata: metadata.clone() }
            }
        }
    }
}
