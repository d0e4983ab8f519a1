//! What a recording states about itself, and what its inspection takes: for an early refusal, before any byte is sent.
//!
//! Plain data. A statement may be wrong or absent, so no rule depends on it: the inspection decides.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

/// The contents of a recording as its own summary section states them.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub struct RecordingSummary {
    /// From the first to the last log time, in nanoseconds.
    pub duration_ns: u64,
    /// Number of messages.
    pub messages: u64,
    /// Number of channels.
    pub channels: u64,
    /// Number of schemas.
    pub schemas: u64,
    /// Bytes of the largest chunk, as it is stored or as it unpacks; 0 without chunks.
    pub largest_chunk_bytes: u64,
    /// Number of messages of each topic.
    pub topics: BTreeMap<String, u64>,
}

/// What an inspection takes, estimated from a summary and the task. All are 0 if no mapping of the task fits the topics.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct InspectionEstimate {
    /// Steps, if the clock of the mapping never pauses.
    pub steps: u64,
    /// The least memory in bytes that a reader needs for the messages.
    pub least_memory_bytes: u64,
    /// The least bytes of the decoded steps: plain scenes of a simulator.
    pub least_decoded_bytes: u64,
    /// The most bytes of the decoded steps: pictures that do not compress.
    pub most_decoded_bytes: u64,
}
