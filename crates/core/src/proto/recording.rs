//! Summaries of recordings and estimates of their inspections on the wire.

use gleaner_proto::v1;

use crate::{InspectionEstimate, RecordingSummary};

/// Reads a summary. Its numbers are statements, so none is wrong here.
pub fn summary_from_proto(summary: v1::RecordingSummary) -> RecordingSummary {
    let v1::RecordingSummary { duration_ns, messages, channels, schemas, largest_chunk_bytes, topics } = summary;
    RecordingSummary { duration_ns, messages, channels, schemas, largest_chunk_bytes, topics }
}

/// A summary.
pub fn summary_to_proto(summary: RecordingSummary) -> v1::RecordingSummary {
    let RecordingSummary { duration_ns, messages, channels, schemas, largest_chunk_bytes, topics } = summary;
    v1::RecordingSummary { duration_ns, messages, channels, schemas, largest_chunk_bytes, topics }
}

/// An estimate.
pub fn estimate_to_proto(estimate: InspectionEstimate) -> v1::InspectionEstimate {
    let InspectionEstimate { steps, least_memory_bytes, least_decoded_bytes, most_decoded_bytes } = estimate;
    v1::InspectionEstimate { steps, least_memory_bytes, least_decoded_bytes, most_decoded_bytes }
}
