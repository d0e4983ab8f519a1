//! The channels of a file as they are declared on the way through it: each message's topic, its place
//! among the topic's messages, and how to decode it.
//!
//! Every pass over a file uses this, so all count the messages of a topic alike.

use std::collections::HashMap;
use std::rc::Rc;

use crate::container::Record;
use crate::dialect::{ChannelSchema, Decoder};
use crate::error::RecordingError;
use crate::limits::Limits;
use crate::report::TopicReport;

/// What is known of a file's channels so far.
pub(crate) struct Channels {
    limits: Limits,
    schemas: HashMap<u16, Schema>,
    channels: HashMap<u16, Channel>,
    /// Each topic and how many of its messages have passed.
    topics: Vec<(String, usize)>,
}

#[derive(Default)]
struct Schema {
    name: String,
    encoding: String,
    data: Vec<u8>,
    /// By the messages' encoding. Channels of one schema share them: thousands may name one that takes long to parse.
    decoders: HashMap<String, Rc<Readable>>,
}

/// A decoder, or why there is none.
type Readable = Result<Decoder, String>;

struct Channel {
    /// Index into the topics; several channels may share one.
    topic: usize,
    decoder: Rc<Readable>,
}

impl Channels {
    pub(crate) fn new(limits: &Limits) -> Self {
        Self { limits: *limits, schemas: HashMap::new(), channels: HashMap::new(), topics: Vec::new() }
    }

    /// For the next message of a channel: its topic, its index in the topic, and the decoder. `None` for a
    /// channel that was never declared.
    pub(crate) fn next(&mut self, channel: u16) -> Option<(&str, usize, &Readable)> {
        let channel = self.channels.get(&channel)?;
        let (topic, count) = self.topics.get_mut(channel.topic)?;
        let index = *count;
        *count += 1;
        Some((topic, index, &channel.decoder))
    }

    /// Takes in a schema or channel; only wanted topics get a decoder. A channel that is new is described.
    ///
    /// # Errors
    /// [`RecordingError::TooLarge`] when there are too many.
    pub(crate) fn learn(
        &mut self,
        record: &Record<'_>,
        wanted: &dyn Fn(&str) -> bool,
    ) -> Result<Option<TopicReport>, RecordingError> {
        match record {
            Record::Schema { id, name, encoding, data } => {
                let schema = Schema {
                    name: (*name).into(),
                    encoding: (*encoding).into(),
                    data: data.to_vec(),
                    ..Schema::default()
                };
                self.schemas.insert(*id, schema);
                self.check("schemas", self.schemas.len())?;
                Ok(None)
            }
            Record::Channel { id, schema_id, topic, encoding, .. } if !self.channels.contains_key(id) => {
                let mut unnamed = Schema::default();
                let schema = self.schemas.get_mut(schema_id).unwrap_or(&mut unnamed);
                let decoder = if wanted(topic) {
                    schema.decoder(encoding, &self.limits)
                } else {
                    Rc::new(Err("not read".to_owned()))
                };
                let schema = schema.name.clone();
                let topic_at = self.topics.iter().position(|(known, _)| known == topic).unwrap_or(self.topics.len());
                if topic_at == self.topics.len() {
                    self.topics.push(((*topic).to_owned(), 0));
                }
                self.channels.insert(*id, Channel { topic: topic_at, decoder });
                self.check("channels", self.channels.len())?;
                let (topic, encoding) = ((*topic).to_owned(), (*encoding).to_owned());
                Ok(Some(TopicReport { topic, schema, encoding, messages: 0, used: false }))
            }
            Record::Channel { .. } | Record::Header { .. } | Record::Message { .. } | Record::Metadata { .. } => {
                Ok(None)
            }
        }
    }

    fn check(&self, what: &str, count: usize) -> Result<(), RecordingError> {
        if count <= self.limits.channels {
            return Ok(());
        }
        let problem = format!("the file has more than {} {what}; record fewer topics", self.limits.channels);
        Err(RecordingError::TooLarge { problem })
    }
}

impl Schema {
    fn decoder(&mut self, message_encoding: &str, limits: &Limits) -> Rc<Readable> {
        if let Some(known) = self.decoders.get(message_encoding) {
            return Rc::clone(known);
        }
        let described =
            ChannelSchema { message_encoding, schema_encoding: &self.encoding, name: &self.name, data: &self.data };
        let decoder = Rc::new(Decoder::new(described, limits));
        self.decoders.insert(message_encoding.to_owned(), Rc::clone(&decoder));
        decoder
    }
}
