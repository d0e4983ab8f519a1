//! Errors of the store, as sentences that name the setting to check.
//!
//! `object_store` exposes neither the status nor the body of an answer, except in the text of its errors.

use std::{error::Error as _, iter::successors, sync::Arc};

use gleaner_core::error::Error;
use object_store::{
    Error as Fault, ObjectStoreExt as _,
    client::{HttpError, HttpErrorKind},
};

use super::{Bucket, OWNER, transfer::ONE_REQUEST_BYTES, wait::wait};

const NO_BUCKET: &str = "NoSuchBucket";
const DENIED_CODE: &str = "AccessDenied";
const FULL_CODE: &str = "StorageFull";
const DENIED: &str = "access is denied: check AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, and that they may read, write, \
     list and delete there";

/// Codes of S3 and of compatible servers, and the sentence for each. A part of a code is enough: MinIO and Ceph add to
/// those of S3 (`XMinioStorageFull`).
const CODES: [(&[&str], &str); 5] = [
    (&[NO_BUCKET], "the bucket does not exist: create it, or fix --blob-store"),
    (
        &["RequestTimeTooSkewed"],
        "the clock of this machine differs too much from that of the store: set it, preferably by NTP, then retry",
    ),
    (
        &[FULL_CODE, "QuotaExceeded", "ServiceQuota", "EntityTooLarge"],
        "the bucket is full, or a quota or size limit of the store is reached: free space in it or raise the limit, then \
         retry",
    ),
    (&["ExpiredToken", "InvalidToken"], "the session token is invalid or has expired: renew AWS_SESSION_TOKEN"),
    (&["InvalidAccessKeyId", "SignatureDoesNotMatch", DENIED_CODE], DENIED),
];

/// What each call does beside reading, and the permission for it.
const WRITES: [(&str, &str, &str); 4] = [
    ("claiming", "write", "s3:PutObject"),
    ("storing", "write", "s3:PutObject"),
    ("renaming", "write", "s3:PutObject"),
    ("removing", "delete", "s3:DeleteObject"),
];

/// Whether the object is missing, in a bucket that exists.
pub(crate) fn is_missing(error: &Fault) -> bool {
    matches!(error, Fault::NotFound { .. }) && code(&error.to_string()) != Some(NO_BUCKET)
}

impl Bucket {
    /// The error for the caller; the store's own words go to the log.
    pub(crate) fn fault(&self, doing: &str, name: &str, error: Fault) -> Error {
        let (text, shown) = (error.to_string(), self.shown());
        // S3 repeats the session token that it rejects.
        let logged = text.split("<Token").next().unwrap_or_default();
        tracing::warn!(
            object.name = name,
            store = shown,
            error = logged,
            "the blob store failed while {doing} an object"
        );
        if is_missing(&error) {
            return Error::damaged(format!("the object {name} is missing in {shown} (--blob-store)"));
        }
        let message = self.reason(doing, &error, &text);
        Error::unavailable(format!("the blob store {shown} (--blob-store) failed while {doing} an object: {message}"))
    }

    fn reason(&self, doing: &str, error: &Fault, text: &str) -> String {
        let code = code(text);
        if let Some((_, verb, permission)) = WRITES.iter().find(|(call, ..)| *call == doing)
            && code == Some(DENIED_CODE)
            && self.is_readable()
        {
            return format!("the credentials may read and not {verb}: grant them {permission} there, then retry");
        }
        let known = code.and_then(|code| CODES.iter().find(|(parts, _)| parts.iter().any(|part| code.contains(part))));
        if let Some((_, sentence)) = known {
            return (*sentence).to_owned();
        }
        if is_stalled(error) {
            return format!(
                "the store sent nothing for {} seconds: check --blob-store-endpoint and the service behind it, or raise \
                 --blob-store-timeout-seconds for a store that takes longer to receive {} MiB, then retry",
                self.timeout.as_secs(),
                ONE_REQUEST_BYTES >> 20
            );
        }
        if matches!(error, Fault::PermissionDenied { .. } | Fault::Unauthenticated { .. }) {
            // An answer to HEAD has no code.
            return format!("{DENIED}; check the clock of this machine too");
        }
        let reason = code.map_or_else(|| first_line(text), |code| format!("the store answered {code}"));
        format!("{reason}; check --blob-store-endpoint, the service behind it and its free space, then retry")
    }

    /// Whether the store accepts the credentials for reads. The object need not exist.
    fn is_readable(&self) -> bool {
        let (store, key) = (Arc::clone(&self.store), self.key(OWNER));
        matches!(wait(async move { store.head(&key).await }), Ok(Ok(_) | Err(Fault::NotFound { .. })))
    }
}

/// The code of the store in the text of an error: of an answer, or of one object among those to remove.
fn code(text: &str) -> Option<&str> {
    if text.contains("status code: 507") {
        return Some(FULL_CODE);
    }
    let between = |begin, end| Some(text.split_once(begin)?.1.split_once(end)?.0);
    let found = between("<Code>", "</Code>").or_else(|| between("(code: ", ")"))?;
    (found.len() <= 64 && found.bytes().all(|byte| byte.is_ascii_alphanumeric())).then_some(found)
}

/// Whether the timeout has passed on an open connection.
fn is_stalled(error: &Fault) -> bool {
    let mut causes = successors(error.source(), |cause| (**cause).source()).filter_map(|cause| cause.downcast_ref());
    causes.any(|http: &HttpError| {
        let connecting = http.source().and_then(|cause| cause.downcast_ref()).is_some_and(reqwest::Error::is_connect);
        http.kind() == HttpErrorKind::Timeout && !connecting
    })
}

/// The first line of the store's message, at most 200 characters: servers send whole pages.
fn first_line(message: &str) -> String {
    message.lines().next().unwrap_or_default().chars().take(200).collect()
}
