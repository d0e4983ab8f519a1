//! The channels of a file as they are declared: the topic of each message, its index in the topic, and its decoder.
//!
//! Every pass over a file uses this, so all count the messages of a topic alike. Messages may come before their
//! channel's declaration in a damaged file; a second pass after [`Channels::rewind`] decodes them.

use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;

use crate::container::Record;
use crate::dialect::{ChannelSchema, Decoder};
use crate::error::RecordingError;
use crate::limits::Limits;
use gleaner_core::TopicReport;

/// The channels of a file that are declared so far.
#[derive(Debug)]
pub(crate) struct Channels {
    limits: Limits,
    schemas: HashMap<u16, Schema>,
    channels: HashMap<u16, Channel>,
    /// Each topic, with the number of its messages read so far.
    topics: Vec<TopicReport>,
    /// Number of messages that came before their channel's declaration, by channel.
    undeclared: BTreeMap<u16, u64>,
}

#[derive(Debug, Default)]
struct Schema {
    name: String,
    encoding: String,
    data: Vec<u8>,
    /// By the messages' encoding. Channels of one schema share them: thousands may name one that takes long to parse.
    decoders: HashMap<String, Arc<Readable>>,
}

/// A decoder, or the reason why the schema is unusable.
pub(crate) type Readable = Result<Decoder, String>;

#[derive(Debug)]
struct Channel {
    /// Index into the topics; several channels may share one.
    topic: usize,
    decoder: Arc<Readable>,
}

impl Channels {
    pub(crate) fn new(limits: &Limits) -> Self {
        Self {
            limits: *limits,
            schemas: HashMap::new(),
            channels: HashMap::new(),
            topics: Vec::new(),
            undeclared: BTreeMap::new(),
        }
    }

    /// For the next message of a channel: its topic, its index in the topic, and the decoder. `None` for a
    /// channel that is not declared so far; its messages are counted.
    pub(crate) fn next(&mut self, channel: u16) -> Option<(&str, usize, &Arc<Readable>)> {
        let Some(declared) = self.channels.get(&channel) else {
            *self.undeclared.entry(channel).or_default() += 1;
            return None;
        };
        let topic = self.topics.get_mut(declared.topic)?;
        let index = usize::try_from(topic.messages).ok()?;
        topic.messages += 1;
        Some((&topic.topic, index, &declared.decoder))
    }

    /// Keeps the declarations and resets the message counts, for another pass over the same file.
    pub(crate) fn rewind(&mut self) {
        self.undeclared.clear();
        for topic in &mut self.topics {
            topic.messages = 0;
        }
    }

    /// Channels with messages before their declaration: the number of those, and the topic if it was declared later.
    pub(crate) fn undeclared(&self) -> Vec<(u16, u64, Option<String>)> {
        let topic = |channel: &u16| self.topics.get(self.channels.get(channel)?.topic).map(|topic| topic.topic.clone());
        self.undeclared.iter().map(|(channel, count)| (*channel, *count, topic(channel))).collect()
    }

    /// Every topic so far, with its number of messages.
    pub(crate) fn topics(&self) -> &[TopicReport] {
        &self.topics
    }

    /// Adds a schema or channel; only wanted topics get a decoder.
    ///
    /// # Errors
    /// [`RecordingError::TooLarge`] if there are too many.
    pub(crate) fn declare(&mut self, record: &Record<'_>, wanted: &dyn Fn(&str) -> bool) -> Result<(), RecordingError> {
        match record {
            Record::Schema { id, name, encoding, data } => {
                // The first of two declarations counts, as in a copy of the recording.
                self.schemas.entry(*id).or_insert_with(|| Schema {
                    name: (*name).into(),
                    encoding: (*encoding).into(),
                    data: data.to_vec(),
                    ..Schema::default()
                });
                self.check("schemas", self.schemas.len())
            }
            Record::Channel { id, schema_id, topic, encoding, .. } if !self.channels.contains_key(id) => {
                let mut unnamed = Schema::default();
                let schema = self.schemas.get_mut(schema_id).unwrap_or(&mut unnamed);
                let decoder = if wanted(topic) {
                    schema.decoder(encoding, &self.limits)
                } else {
                    Arc::new(Err("not read".to_owned()))
                };
                let schema = schema.name.clone();
                let at = self.topics.iter().position(|known| known.topic == *topic).unwrap_or(self.topics.len());
                if at == self.topics.len() {
                    let (topic, encoding) = ((*topic).to_owned(), (*encoding).to_owned());
                    self.topics.push(TopicReport { topic, schema, encoding, messages: 0, used: false });
                }
                self.channels.insert(*id, Channel { topic: at, decoder });
                self.check("channels", self.channels.len())
            }
            Record::Channel { .. }
            | Record::Header { .. }
            | Record::Message { .. }
            | Record::Metadata { .. }
            | Record::Attachment { .. } => Ok(()),
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
    fn decoder(&mut self, message_encoding: &str, limits: &Limits) -> Arc<Readable> {
        if let Some(known) = self.decoders.get(message_encoding) {
            return Arc::clone(known);
        }
        let described =
            ChannelSchema { message_encoding, schema_encoding: &self.encoding, name: &self.name, data: &self.data };
        let decoder = Arc::new(Decoder::new(described, limits));
        self.decoders.insert(message_encoding.to_owned(), Arc::clone(&decoder));
        decoder
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_of_two_declarations_of_a_schema_counts() {
        let mut channels = Channels::new(&Limits::default());
        let schema = |name| Record::Schema { id: 1, name, encoding: "", data: &[] };
        let channel = Record::Channel { id: 1, schema_id: 1, topic: "/a", encoding: "json", metadata: BTreeMap::new() };
        for record in [schema("first"), schema("second"), channel] {
            channels.declare(&record, &|_| true).unwrap();
        }
        assert_eq!(channels.topics()[0].schema, "first");
    }
}
