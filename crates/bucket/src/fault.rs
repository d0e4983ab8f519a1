//! Errors of the store, as sentences that name the setting to check.

use gleaner_core::error::Error;

/// Whether the object is missing, in a bucket that exists.
pub(crate) fn is_missing(error: &object_store::Error) -> bool {
    matches!(error, object_store::Error::NotFound { .. }) && !is_without_bucket(error)
}

fn is_without_bucket(error: &object_store::Error) -> bool {
    error.to_string().contains("NoSuchBucket")
}

/// The error for the caller; the store's own words go to the log.
pub(crate) fn described(shown: &str, doing: &str, name: &str, error: &object_store::Error) -> Error {
    use object_store::Error as Fault;
    tracing::warn!(object.name = name, store = shown, %error, "the blob store failed while {doing} an object");
    #[expect(clippy::wildcard_enum_match_arm, reason = "the enum is open, and all other errors read alike")]
    let message = match error {
        error if is_without_bucket(error) => "the bucket does not exist: create it, or fix --blob-store".to_owned(),
        Fault::NotFound { .. } => {
            return Error::internal(format!("{doing} {name} in {shown}"), "the object is missing");
        }
        Fault::PermissionDenied { .. } | Fault::Unauthenticated { .. } => {
            "access is denied: check AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, and that they may read, write, list \
             and delete there"
                .to_owned()
        }
        error => format!(
            "{}; check --blob-store-endpoint, the service behind it and its free space, then retry",
            first_line(&error.to_string())
        ),
    };
    Error::unavailable(format!("the blob store {shown} failed while {doing} an object: {message}"))
}

/// The first line of the store's message, at most 200 characters: servers send whole pages.
fn first_line(message: &str) -> String {
    message.lines().next().unwrap_or_default().chars().take(200).collect()
}
