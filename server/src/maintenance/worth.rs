//! The decision whether a blob without a row must stay: recordings stay unless a user deleted them, whatever the
//! database lacks. Must not depend on the database.

use crate::{
    blobs::{Blobs, Found},
    domain::description::Description,
};

/// The first bytes of an MCAP file.
const MCAP: &[u8] = b"\x89MCAP0\r\n";

/// Whether a file is a recording, by its first bytes.
pub(super) fn is_recording(found: &Found) -> bool {
    found.begins_with(MCAP)
}

/// Whether a blob in the trash must not be deleted for its age: a recording, unless all its descriptions mark it as
/// deleted by a user. An unreadable description does not count as such a mark.
pub(super) fn stays(found: &Found, described: &[Vec<u8>]) -> bool {
    let mut descriptions = described.iter().map(|json| Description::read(json));
    let recording = |description: &Option<Description>| match description {
        Some(Description::Recording(_)) | None => true,
        Some(Description::Task { .. } | Description::Encoder { .. } | Description::Policy { .. }) => false,
    };
    match described.is_empty() {
        true => is_recording(found),
        false => {
            descriptions.any(|found| recording(&found) && !found.is_some_and(|found| found.is_deleted_recording()))
        }
    }
}

/// Whether a blob without a row suggests that the database belongs to other blobs: a recording that must stay, or a
/// result with a description. Files left by jobs are expected.
pub(super) fn is_unexplained(blobs: &Blobs, found: &Found) -> bool {
    match found.id.as_ref().map(|id| blobs.descriptions(id)) {
        Some(Ok(described)) => {
            let result = |json: &Vec<u8>| {
                matches!(Description::read(json), Some(Description::Encoder { .. } | Description::Policy { .. }))
            };
            stays(found, &described) || described.iter().any(result)
        }
        Some(Err(_)) | None => true,
    }
}
