//! The channels of a file as they are declared on the way through it: each message's topic, its place
//! among the topic's messages, and how to decode it.
//!
//! Every pass over a file uses this, so all count the messages of a topic alike.

use std::collections::HashMap;

use crate::container::Record;
use crate::dialect::{ChannelSchema, Decoder};
use crate::report::TopicReport;

/// What is known of a file's channels so far.
#[derive(Default)]
pub(crate) struct Channels {
    schemas: HashMap<u16, Schema>,
    channels: HashMap<u16, Channel>,
    /// Each topic and how many of its messages have passed.
    topics: Vec<(String, usize)>,
}

#[derive(Clone, Debug, Default)]
struct Schema {
    name: String,
    encoding: String,
    data: Vec<u8>,
}

struct Channel {
    /// Index into the topics; several channels may share one.
    topic: usize,
    decoder: Result<Decoder, String>,
}

impl Channels {
    /// For the next message of a channel: its topic, its index in the topic, and the decoder. `None` for a
    /// channel that was never declared.
    pub(crate) fn next(&mut self, channel: u16) -> Option<(&str, usize, &Result<Decoder, String>)> {
        let channel = self.channels.get(&channel)?;
        let (topic, count) = self.topics.get_mut(channel.topic)?;
        let index = *count;
        *count += 1;
        Some((topic, index, &channel.decoder))
    }

    /// Takes in a schema or channel; only wanted topics get a decoder. A channel that is new is described.
    pub(crate) fn learn(&mut self, record: &Record<'_>, wanted: &dyn Fn(&str) -> bool) -> Option<TopicReport> {
        match record {
            Record::Schema { id, name, encoding, data } => {
                let schema = Schema { name: (*name).into(), encoding: (*encoding).into(), data: data.to_vec() };
                self.schemas.insert(*id, schema);
                None
            }
            Record::Channel { id, schema_id, topic, encoding, .. } if !self.channels.contains_key(id) => {
                let schema = self.schemas.get(schema_id).cloned().unwrap_or_default();
                let described = ChannelSchema {
                    message_encoding: encoding,
                    schema_encoding: &schema.encoding,
                    name: &schema.name,
                    data: &schema.data,
                };
                let decoder = if wanted(topic) { Decoder::new(described) } else { Err("not read".to_owned()) };
                let topic_at = self.topics.iter().position(|(known, _)| known == topic).unwrap_or(self.topics.len());
                if topic_at == self.topics.len() {
                    self.topics.push(((*topic).to_owned(), 0));
                }
                self.channels.insert(*id, Channel { topic: topic_at, decoder });
                Some(TopicReport {
                    topic: (*topic).to_owned(),
                    schema: schema.name,
                    encoding: (*encoding).to_owned(),
                    messages: 0,
                    used: false,
                })
            }
            Record::Channel { .. } | Record::Header { .. } | Record::Message { .. } | Record::Metadata { .. } => None,
        }
    }
}
