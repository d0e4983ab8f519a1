//! The dialects: decoders of messages in each encoding into one type, [`Value`].
//!
//! This module does not depend on tasks, mappings or steps.

mod budget;
mod cdr;
pub(crate) mod json;
mod protobuf;
mod ros2msg;
mod value;

use crate::limits::Limits;
pub(crate) use value::Value;

/// Turns the messages of one channel into values.
#[derive(Debug)]
pub(crate) enum Decoder {
    Protobuf(protobuf::Decoder),
    Cdr(cdr::Decoder),
    Json {
        /// Deepest nesting.
        depth: usize,
    },
}

/// The description of a channel's messages in an MCAP file.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ChannelSchema<'a> {
    /// Encoding of the messages.
    pub(crate) message_encoding: &'a str,
    /// Encoding of the schema; empty without one.
    pub(crate) schema_encoding: &'a str,
    /// Name of the message type; empty without a schema.
    pub(crate) name: &'a str,
    /// The schema itself.
    pub(crate) data: &'a [u8],
}

impl Decoder {
    /// Creates the decoder of a channel's messages; the error has the reason and the fix.
    pub(crate) fn new(schema: ChannelSchema<'_>, limits: &Limits) -> Result<Self, String> {
        match (schema.message_encoding, schema.schema_encoding) {
            ("protobuf", "protobuf") => protobuf::Decoder::new(schema.name, schema.data).map(Self::Protobuf),
            ("cdr", "ros2msg") => cdr::Decoder::new(schema.name, schema.data).map(Self::Cdr),
            ("json", _) => Ok(Self::Json { depth: limits.json_depth }),
            (message, schema) => Err(format!(
                "messages are encoded as `{message}` with a `{schema}` schema, which cannot be read; record with \
                 protobuf (protobuf schema), cdr (ros2msg schema) or json"
            )),
        }
    }

    /// Decodes one message; the error names the place that does not match the schema.
    pub(crate) fn decode<'a>(&'a self, bytes: &'a [u8]) -> Result<Value<'a>, String> {
        match self {
            Self::Protobuf(decoder) => decoder.decode(bytes),
            Self::Cdr(decoder) => decoder.decode(bytes),
            Self::Json { depth } => json::decode(bytes, *depth),
        }
    }
}
