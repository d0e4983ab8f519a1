//! The error of the server: its kind, a message for the caller, and its cause for the log.
//!
//! Must not depend on status codes: `wire::status` has that table.

use std::{
    error::Error as StdError,
    io::ErrorKind,
    panic::{AssertUnwindSafe, catch_unwind},
};

/// Kinds of errors, by the caller's remedy. `wire::status` has one row for each.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// The request is wrong; its named field has to be fixed.
    Invalid,
    /// The caller is not authenticated: its token is missing or invalid.
    Unauthenticated,
    /// The caller's role does not allow the call.
    Forbidden,
    /// The request names something that does not exist.
    NotFound,
    /// The request would make something that already exists.
    Exists,
    /// The request is valid, but not in the present state.
    Precondition,
    /// A limit is reached.
    Exhausted,
    /// The caller or the server cancelled the call.
    Cancelled,
    /// The deadline passed.
    Late,
    /// A resource is not ready or is going away; the caller may retry.
    Unavailable,
    /// A stored file is missing or damaged; an operator has to restore it.
    Damaged,
    /// A fault of the server. Its message is logged, not sent.
    Internal,
}

/// An error with its kind, a message for the caller and, for the log, its cause.
#[derive(Debug)]
pub struct Error {
    kind: Kind,
    message: String,
    source: Option<Box<dyn StdError + Send + Sync>>,
}

/// The result of every fallible function of the server.
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// The request is wrong. `field` is its path in the request; `fix` is what is wrong and what to do.
    pub fn invalid(field: &str, fix: impl std::fmt::Display) -> Self {
        Self::new(Kind::Invalid, format!("{field}: {fix}"))
    }

    /// The caller is not authenticated; the message names the remedy.
    pub fn unauthenticated(message: impl Into<String>) -> Self {
        Self::new(Kind::Unauthenticated, message)
    }

    /// The caller's role does not allow the call; the message names what is needed.
    pub fn forbidden(message: impl Into<String>) -> Self {
        Self::new(Kind::Forbidden, message)
    }

    /// No object of type `what` has this name or id.
    pub fn not_found(what: &str, id: impl std::fmt::Display) -> Self {
        Self::new(Kind::NotFound, format!("no {what} {id}"))
    }

    /// The object already exists; the message names it and the remedy.
    pub fn exists(message: impl Into<String>) -> Self {
        Self::new(Kind::Exists, message)
    }

    /// The request does not fit the present state; the message names what must come first.
    pub fn precondition(message: impl Into<String>) -> Self {
        Self::new(Kind::Precondition, message)
    }

    /// A limit is reached; the message names it.
    pub fn exhausted(message: impl Into<String>) -> Self {
        Self::new(Kind::Exhausted, message)
    }

    /// The call was cancelled.
    pub fn cancelled(message: impl Into<String>) -> Self {
        Self::new(Kind::Cancelled, message)
    }

    /// The deadline passed; the message names what was waited for.
    pub fn late(message: impl Into<String>) -> Self {
        Self::new(Kind::Late, message)
    }

    /// A resource is not ready, or is going away.
    pub fn unavailable(message: impl Into<String>) -> Self {
        Self::new(Kind::Unavailable, message)
    }

    /// A stored file is missing or damaged; `what` names it, and the setting of the place where it is kept.
    pub fn damaged(what: impl std::fmt::Display) -> Self {
        Self::new(
            Kind::Damaged,
            format!(
                "{what}. `gleaner-server check` lists every such file; restore it from a backup. A recording that is \
                 missing can also be pushed again"
            ),
        )
    }

    /// A fault of the server; `doing` names what failed. A disk that rejects writes is not a fault of the server: the
    /// error is then Exhausted.
    pub fn internal(doing: impl Into<String>, source: impl Into<Box<dyn StdError + Send + Sync>>) -> Self {
        let (doing, source) = (doing.into(), source.into());
        match refusal(source.as_ref()) {
            Some(why) => Self::refused_by_disk(why, &doing, source),
            None => Self { kind: Kind::Internal, message: doing, source: Some(source) },
        }
    }

    /// The disk rejects writes: `why` is for the caller; `doing` and the source are for the log.
    pub fn refused_by_disk(why: &str, doing: &str, source: impl Into<Box<dyn StdError + Send + Sync>>) -> Self {
        let source: Box<dyn StdError + Send + Sync> = source.into();
        Self { kind: Kind::Exhausted, message: why.to_owned(), source: Some(format!("{doing}: {source}").into()) }
    }

    fn new(kind: Kind, message: impl Into<String>) -> Self {
        Self { kind, message: message.into(), source: None }
    }

    /// The kind of the error.
    pub fn kind(&self) -> Kind {
        self.kind
    }

    /// The message, as the caller receives it (unless internal).
    pub fn message(&self) -> &str {
        &self.message
    }
}

impl std::fmt::Display for Error {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.message)?;
        if let Some(source) = &self.source {
            write!(f, ": {source}")?;
        }
        Ok(())
    }
}

impl StdError for Error {
    fn source(&self) -> Option<&(dyn StdError + 'static)> {
        self.source.as_deref().map(|source| source as _)
    }
}

/// The caller's message when a disk is full or cannot be written.
pub const DISK_FULL: &str = "the server's disk is full: no part of this request was stored. Free some space on the disk \
     of its data folder (--data-dir), then retry";
/// The caller's message when a disk is read-only.
pub const DISK_READ_ONLY: &str = "the server's disk cannot be written: no part of this request was stored. Repair or \
     remount the disk of its data folder (--data-dir), then retry";

/// The message for a write beyond the largest file that the process or the file system allows.
pub const FILE_TOO_LARGE: &str = "a file of the server has reached the largest size that its process or its file \
     system allows: no part of this request was stored. Raise the limit (`ulimit -f`, LimitFSIZE= of its service) or \
     use another file system, then retry";

/// The message for a disk that rejected a write, if such an error is among the causes.
fn refusal(error: &(dyn StdError + Send + Sync + 'static)) -> Option<&'static str> {
    let mut cause: Option<&(dyn StdError + 'static)> = Some(error);
    while let Some(error) = cause {
        match error.downcast_ref::<std::io::Error>().map(std::io::Error::kind) {
            Some(ErrorKind::StorageFull | ErrorKind::QuotaExceeded) => return Some(DISK_FULL),
            Some(ErrorKind::FileTooLarge) => return Some(FILE_TOO_LARGE),
            Some(ErrorKind::ReadOnlyFilesystem) => return Some(DISK_READ_ONLY),
            // An io::Error that wraps another one has the cause further down.
            Some(_) | None => cause = error.source(),
        }
    }
    None
}

/// Runs `work` and turns a panic into an error: a fault of one call must not end the thread that serves all.
///
/// # Errors
/// The error of `work`; Internal when it panics.
pub fn guarded<T>(doing: &str, work: impl FnOnce() -> Result<T>) -> Result<T> {
    // The values that `work` borrows are only read, so a panic leaves none of them half written.
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|panic| {
        let text = panic
            .downcast_ref::<String>()
            .map(String::as_str)
            .or_else(|| panic.downcast_ref::<&str>().copied())
            .unwrap_or("a panic without a message");
        Err(Error::internal(doing, text))
    })
}

#[cfg(test)]
mod tests {
    use std::io;

    use super::*;

    /// An error of another crate with an io::Error as its source.
    #[derive(Debug, thiserror::Error)]
    #[error("writing the episode")]
    struct Outer(#[source] io::Error);

    #[test]
    fn a_full_disk_is_a_limit_in_every_layer() {
        for (number, message) in [(28, DISK_FULL), (122, DISK_FULL), (27, FILE_TOO_LARGE), (30, DISK_READ_ONLY)] {
            let refused = || io::Error::from_raw_os_error(number);
            let wrapped = io::Error::other(Outer(refused()));
            for error in [
                Error::internal("writing a file", refused()),
                Error::internal("writing a file", Outer(refused())),
                Error::internal("writing a file", Outer(wrapped)),
            ] {
                assert_eq!((error.kind(), error.message()), (Kind::Exhausted, message));
                assert!(error.to_string().contains("writing a file: "), "the log says what was done: {error}");
            }
        }
    }

    #[test]
    fn other_faults_are_internal() {
        for number in [5, 13, 2] {
            let error = Error::internal("reading a file", io::Error::from_raw_os_error(number));
            assert_eq!((error.kind(), error.message()), (Kind::Internal, "reading a file"));
        }
    }
}
