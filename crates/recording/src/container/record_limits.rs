//! The limits on one record: its number in the file, its length, and the names in it. Independent of files and frames.

use super::record::Record;
use crate::error::RecordingError;
use crate::limits::Limits;

/// Compares the number and the length of a record with the limits.
pub(super) fn check_size(records: u64, bytes: usize, limits: &Limits) -> Result<(), RecordingError> {
    let too_large = |problem| Err(RecordingError::TooLarge { problem });
    if records > limits.records {
        return too_large(format!("the file has more than {} records; split the recording", limits.records));
    }
    if bytes > limits.record_bytes {
        return too_large(format!(
            "a record has {bytes} bytes and may have {}; record smaller messages",
            limits.record_bytes
        ));
    }
    Ok(())
}

/// Names end up in reports, messages and logs.
pub(super) fn check_names(record: &Record<'_>, limits: &Limits) -> Result<(), RecordingError> {
    let names = match record {
        Record::Schema { name, encoding, .. } => [("a schema's name", *name), ("a schema's encoding", *encoding)],
        Record::Channel { topic, encoding, .. } => [("a topic", *topic), ("a channel's encoding", *encoding)],
        Record::Header { profile } => [("the profile", *profile), ("", "")],
        Record::Metadata { name, .. } => [("the name of metadata", *name), ("", "")],
        Record::Message { .. } | Record::Attachment { .. } => return Ok(()),
    };
    for (what, name) in names {
        if name.len() > limits.name_bytes {
            let problem = format!(
                "{what} has {} bytes and may have {}; record it under a shorter name",
                name.len(),
                limits.name_bytes
            );
            return Err(RecordingError::TooLarge { problem });
        }
        if name.chars().any(char::is_control) {
            let problem = format!("{what} has control characters: {name:?}; record it under a plain name");
            return Err(RecordingError::Damaged { problem });
        }
    }
    Ok(())
}
