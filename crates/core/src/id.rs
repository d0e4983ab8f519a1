//! Identifiers: a ULID behind a prefix that names its type, such as `ep_01J…`.
//!
//! Every id that reaches another module has been parsed here, so no string of a client becomes a path or a key.

use std::sync::{Mutex, PoisonError};

use crate::error::{Error, Result};

/// Ids of one millisecond also sort in order of creation, so lists and pages by id are lists by age.
static GENERATOR: Mutex<ulid::Generator> = Mutex::new(ulid::Generator::new());

fn next() -> ulid::Ulid {
    let mut generator = GENERATOR.lock().unwrap_or_else(PoisonError::into_inner);
    // Fails only when the 80 random bits of one millisecond overflow; the only loss is the order within that
    // millisecond.
    generator.generate().unwrap_or_else(|_| ulid::Ulid::generate())
}

/// A text that no other call returns, for a caller's keys.
pub fn unique() -> String {
    next().to_string()
}

macro_rules! ids {
    ($($(#[$doc:meta])* $name:ident, $prefix:literal, $what:literal;)*) => {$(
        $(#[$doc])*
        #[derive(Debug, Clone, PartialEq, Eq, Hash, PartialOrd, Ord, serde::Serialize, serde::Deserialize)]
        #[serde(try_from = "String", into = "String")]
        pub struct $name(String);

        impl $name {
            /// The named type, in words.
            pub const WHAT: &'static str = $what;

            /// A new id; later ones sort after earlier ones.
            #[expect(clippy::new_without_default, reason = "each call gives another id")]
            pub fn new() -> Self {
                Self(format!("{}_{}", $prefix, next()))
            }

            /// Reads an id that a caller gave in `field`.
            ///
            /// # Errors
            /// Invalid when it has not the form `prefix_ULID`.
            pub fn parse(field: &str, text: &str) -> Result<Self> {
                Self::try_from(text.to_owned()).map_err(|problem| Error::invalid(field, problem))
            }

            /// The id as text.
            pub fn as_str(&self) -> &str {
                &self.0
            }
        }

        impl TryFrom<String> for $name {
            type Error = String;

            fn try_from(text: String) -> std::result::Result<Self, String> {
                match text.strip_prefix(concat!($prefix, "_")).map(ulid::Ulid::from_string) {
                    Some(Ok(_)) => Ok(Self(text)),
                    Some(Err(_)) | None => Err(format!(
                        "{:?} is not {}; such an id looks like {}_01ARZ3NDEKTSV4RRFFQ69G5FAV",
                        text.chars().take(64).collect::<String>(), concat!("the id of ", $what), $prefix
                    )),
                }
            }
        }

        impl From<$name> for String {
            fn from(id: $name) -> String {
                id.0
            }
        }

        impl std::fmt::Display for $name {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str(&self.0)
            }
        }
    )*};
}

ids! {
    /// Names a task.
    TaskId, "task", "a task";
    /// Names an episode.
    EpisodeId, "ep", "an episode";
    /// Names an open upload.
    UploadId, "up", "an upload";
    /// Names a snapshot.
    SnapshotId, "snap", "a snapshot";
    /// Names a job.
    JobId, "job", "a job";
    /// Names an encoder.
    EncoderId, "enc", "an encoder";
    /// Names a score run.
    ScoreRunId, "run", "a score run";
    /// Names a dataset.
    DatasetId, "ds", "a dataset";
    /// Names an export.
    ExportId, "exp", "an export";
    /// Names a policy.
    PolicyId, "pol", "a policy";
    /// Names an evaluation.
    EvaluationId, "eval", "an evaluation";
    /// Names a schedule.
    ScheduleId, "sch", "a schedule";
    /// Names a session.
    SessionId, "ses", "a session";
    /// Names a token; the id may be shown, the token itself not.
    TokenId, "tok", "a token";
}

/// A blob's name: the BLAKE3 of its content, 64 hexadecimal digits.
#[derive(Debug, Clone, PartialEq, Eq, Hash, PartialOrd, Ord, serde::Serialize, serde::Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct BlobId(String);

impl BlobId {
    /// Reads a digest that a caller gave in `field`.
    ///
    /// # Errors
    /// Invalid when it is not 64 hexadecimal digits.
    pub fn parse(field: &str, text: &str) -> Result<Self> {
        Self::try_from(text.to_owned()).map_err(|problem| Error::invalid(field, problem))
    }

    /// The digest in lower-case hexadecimal digits.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl From<blake3::Hash> for BlobId {
    fn from(hash: blake3::Hash) -> Self {
        Self(hash.to_hex().to_string())
    }
}

impl TryFrom<String> for BlobId {
    type Error = String;

    fn try_from(text: String) -> std::result::Result<Self, String> {
        match blake3::Hash::from_hex(&text) {
            Ok(hash) => Ok(hash.into()),
            Err(_) => Err("must be a BLAKE3 digest, 64 hexadecimal digits".to_owned()),
        }
    }
}

impl From<BlobId> for String {
    fn from(id: BlobId) -> String {
        id.0
    }
}

impl std::fmt::Display for BlobId {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn ids_survive_a_round_trip_and_refuse_other_kinds() {
        let id = EpisodeId::new();
        assert_eq!(EpisodeId::parse("episode_id", id.as_str()).unwrap(), id);
        let error = TaskId::parse("task", id.as_str()).unwrap_err();
        assert!(error.message().starts_with("task: "), "{error}");
        assert!(EpisodeId::parse("episode_id", "ep_../../etc/passwd").is_err());
    }

    proptest! {
        /// An accepted text round-trips, and is usable as a file name but not as a path.
        #[test]
        fn parsed_ids_equal_their_text(prefix in "(ep|task|EP|)", rest in "(_[0-9A-Za-z]{26}|\\PC{0,40}|_[0-7][0-9A-HJKMNP-TV-Z]{25})") {
            let text = format!("{prefix}{rest}");
            if let Ok(id) = EpisodeId::parse("episode_id", &text) {
                prop_assert_eq!(id.as_str(), &text);
                prop_assert_eq!(String::from(id.clone()), text.clone());
                prop_assert!(text.chars().all(|c| c.is_ascii_alphanumeric() || c == '_'), "{}", text);
                let json = serde_json::to_string(&id).unwrap();
                prop_assert_eq!(serde_json::from_str::<EpisodeId>(&json).unwrap(), id);
                prop_assert!(TaskId::parse("task", &text).is_err());
            }
        }

        #[test]
        fn parsed_digests_are_lower_case(text in "([0-9a-fA-F]{64}|\\PC{0,70})") {
            if let Ok(blob) = BlobId::parse("blake3", &text) {
                prop_assert_eq!(blob.as_str(), text.to_lowercase());
            }
        }
    }

    #[test]
    fn later_ids_sort_after_earlier_ones() {
        let ids: Vec<_> = (0..1000).map(|_| EpisodeId::new()).collect();
        assert!(ids.is_sorted());
    }

    #[test]
    fn blobs_are_lower_case_digests() {
        let hash = blake3::hash(b"gleaner");
        let upper = hash.to_hex().to_string().to_uppercase();
        assert_eq!(BlobId::parse("blake3", &upper).unwrap(), hash.into());
        assert!(BlobId::parse("blake3", "abc").is_err());
    }
}
