//! Counts of a file's records, and their differences from the file's own statistics.

use std::collections::{BTreeMap, BTreeSet};

use super::Place;
use super::index::Statistics;

/// Counts of the records that were read from a file.
#[derive(Debug, Default)]
pub(super) struct Counts {
    messages: BTreeMap<u16, u64>,
    /// Log times of the first and the last message.
    times: Option<(u64, u64)>,
    schemas: Declared,
    channels: Declared,
    pub(super) attachments: u64,
    pub(super) metadata: u64,
    pub(super) chunks: u64,
}

/// The identifiers of schemas or channels.
#[derive(Debug, Default)]
struct Declared {
    data: BTreeSet<u16>,
    /// The identifiers in the summary section, which repeats all or none of the others.
    summary: BTreeSet<u16>,
}

impl Declared {
    fn add(&mut self, id: u16, place: Place) {
        let section = if place == Place::Summary { &mut self.summary } else { &mut self.data };
        section.insert(id);
    }

    /// Their number in the data section, and in the whole file. A declaration without messages may be in the
    /// summary section only.
    fn counts(&self) -> [u64; 2] {
        [self.data.len() as u64, self.data.union(&self.summary).count() as u64]
    }

    fn is_repeated_in_part(&self) -> bool {
        !self.summary.is_empty() && !self.data.is_subset(&self.summary)
    }
}

impl Counts {
    pub(super) fn schema(&mut self, id: u16, place: Place) {
        self.schemas.add(id, place);
    }

    pub(super) fn channel(&mut self, id: u16, place: Place) {
        self.channels.add(id, place);
    }

    /// Whether the summary section lacks some schemas or channels although it has others: readers that begin with it
    /// fail on the messages of those.
    pub(super) fn are_repeated_in_part(&self) -> bool {
        self.schemas.is_repeated_in_part() || self.channels.is_repeated_in_part()
    }

    pub(super) fn message(&mut self, channel: u16, log_time: u64) {
        *self.messages.entry(channel).or_default() += 1;
        let (first, last) = self.times.unwrap_or((log_time, log_time));
        self.times = Some((first.min(log_time), last.max(log_time)));
    }

    /// Describes where the statistics differ.
    pub(super) fn difference(&self, statistics: &Statistics) -> Option<String> {
        let messages = self.messages.values().sum::<u64>();
        let counts = [
            ("messages", statistics.messages, [messages; 2]),
            ("schemas", statistics.schemas, self.schemas.counts()),
            ("channels", statistics.channels, self.channels.counts()),
            ("attachments", statistics.attachments, [self.attachments; 2]),
            ("metadata records", statistics.metadata, [self.metadata; 2]),
            ("chunks", statistics.chunks, [self.chunks; 2]),
        ];
        let mut differences: Vec<String> = counts
            .iter()
            .filter(|(_, stated, found)| !found.contains(stated))
            .map(|(what, stated, [found, _])| format!("{stated} {what} (the file has {found})"))
            .collect();
        if statistics.times != self.times.unwrap_or_default() {
            differences.push("times of the first and last message that differ from the messages".to_owned());
        }
        let stated = statistics.channel_messages.iter().filter(|(_, count)| **count > 0);
        if !stated.eq(self.messages.iter()) {
            differences.push("a number of messages on some channel that differs from the messages".to_owned());
        }
        (!differences.is_empty()).then(|| format!("they state {}", differences.join("; ")))
    }
}
