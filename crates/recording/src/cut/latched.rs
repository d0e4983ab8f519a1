//! Messages that hold from their time on, for all that follows: a recorder has them once, at its beginning, and every episode
//! needs them.

use std::collections::{BTreeMap, HashSet};

use mcap::records::MessageHeader;

/// The topic of the transforms that never change, which recorders other than ROS's do not mark.
const STATIC: &str = "tf_static";
/// What a ROS recorder writes of such a topic: its durability in words, or by its number.
const QUALITIES: &str = "offered_qos_profiles";
const LATCHED: [&str; 2] = ["durability: transient_local", "durability: 1\n"];
/// Most bytes of such messages that are kept; later ones are of their own episode alone.
const MOST_BYTES: usize = 16 << 20;

/// The messages so far of topics whose messages hold from their time on.
#[derive(Debug, Default)]
pub(super) struct Latched {
    channels: HashSet<u16>,
    messages: Vec<(MessageHeader, Vec<u8>)>,
    bytes: usize,
}

impl Latched {
    /// Takes the declaration of a channel.
    pub(super) fn declare(&mut self, id: u16, topic: &str, metadata: &BTreeMap<String, String>) {
        let qualities = metadata.get(QUALITIES).map(String::as_str).unwrap_or_default();
        if topic.rsplit('/').next() == Some(STATIC) || LATCHED.iter().any(|latched| qualities.contains(latched)) {
            self.channels.insert(id);
        }
    }

    /// Takes a message, if it holds for later episodes.
    pub(super) fn push(&mut self, header: MessageHeader, data: &[u8]) {
        if self.channels.contains(&header.channel_id) && self.bytes + data.len() <= MOST_BYTES {
            self.bytes += data.len();
            self.messages.push((header, data.to_vec()));
        }
    }

    /// The messages from before an episode, as logged at its begin.
    pub(super) fn before(&self, begin: u64) -> impl Iterator<Item = (MessageHeader, &[u8])> {
        let earlier = self.messages.iter().filter(move |(header, _)| header.log_time < begin);
        earlier.map(move |(header, data)| (MessageHeader { log_time: begin, ..*header }, data.as_slice()))
    }
}
