//! Counts of what a file holds, and where its own statistics differ.

use std::collections::{BTreeMap, BTreeSet};

use super::index::Statistics;
use super::integrity::Place;

/// What was read of a file, in numbers.
#[derive(Debug, Default)]
pub(super) struct Counts {
    messages: BTreeMap<u16, u64>,
    /// Log times of the first and the last message.
    times: Option<(u64, u64)>,
    /// Of the data section, and of the whole file.
    schemas: (BTreeSet<u16>, BTreeSet<u16>),
    channels: (BTreeSet<u16>, BTreeSet<u16>),
    pub(super) attachments: u64,
    pub(super) metadata: u64,
    pub(super) chunks: u64,
}

impl Counts {
    pub(super) fn schema(&mut self, id: u16, place: Place) {
        Self::declare(&mut self.schemas, id, place);
    }

    pub(super) fn channel(&mut self, id: u16, place: Place) {
        Self::declare(&mut self.channels, id, place);
    }

    fn declare((data, all): &mut (BTreeSet<u16>, BTreeSet<u16>), id: u16, place: Place) {
        all.insert(id);
        if place != Place::Summary {
            data.insert(id);
        }
    }

    pub(super) fn message(&mut self, channel: u16, log_time: u64) {
        *self.messages.entry(channel).or_default() += 1;
        let (first, last) = self.times.unwrap_or((log_time, log_time));
        self.times = Some((first.min(log_time), last.max(log_time)));
    }

    /// Where the statistics differ, in words.
    pub(super) fn difference(&self, statistics: &Statistics) -> Option<String> {
        let messages = self.messages.values().sum::<u64>();
        let counts = [
            ("messages", statistics.messages, [messages; 2]),
            // A declaration without messages may be in the summary section only.
            ("schemas", statistics.schemas, [self.schemas.0.len() as u64, self.schemas.1.len() as u64]),
            ("channels", statistics.channels, [self.channels.0.len() as u64, self.channels.1.len() as u64]),
            ("attachments", statistics.attachments, [self.attachments; 2]),
            ("metadata records", statistics.metadata, [self.metadata; 2]),
            ("chunks", statistics.chunks, [self.chunks; 2]),
        ];
        let mut differences: Vec<String> = counts
            .iter()
            .filter(|(_, stated, found)| !found.contains(stated))
            .map(|(what, stated, [found, _])| format!("{stated} {what}, {found} are there"))
            .collect();
        if statistics.times != self.times.unwrap_or_default() {
            differences.push("other times of the first and last message than there are".to_owned());
        }
        let stated = statistics.channel_messages.iter().filter(|(_, count)| **count > 0);
        if !stated.eq(self.messages.iter()) {
            differences.push("other numbers of messages on some channel than there are".to_owned());
        }
        (!differences.is_empty()).then(|| format!("they say {}", differences.join("; ")))
    }
}
