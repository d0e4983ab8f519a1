//! The one error of the server: what kind, what to tell, what caused it.
//!
//! Knows no status code: `wire::status` holds that table. A message is for the caller; a source is for the log.

use std::{
    error::Error as StdError,
    panic::{AssertUnwindSafe, catch_unwind},
};

use gleaner_learn::LearnError;

/// What a caller can do about an error. One row each in `wire::status`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// The request is wrong: mend the named field.
    Invalid,
    /// What the request names is not there.
    NotFound,
    /// What the request would make is there already.
    Exists,
    /// The request is right but comes at the wrong time.
    Precondition,
    /// A limit is reached.
    Exhausted,
    /// The caller or the server gave up on purpose.
    Cancelled,
    /// It did not come in time.
    Late,
    /// Something is not ready or going away: try again.
    Unavailable,
    /// Our fault. The message stays in the log.
    Internal,
}

/// An error with its kind, a message for the caller and, for the log, its cause.
#[derive(Debug)]
pub struct Error {
    kind: Kind,
    message: String,
    source: Option<Box<dyn StdError + Send + Sync>>,
}

/// What every fallible call of the server returns.
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// The request is wrong. `field` is its path in the request; `mend` says what is wrong and what to do.
    pub fn invalid(field: &str, mend: impl std::fmt::Display) -> Self {
        Self::new(Kind::Invalid, format!("{field}: {mend}"))
    }

    /// Nothing called `what` has this name or id.
    pub fn not_found(what: &str, id: impl std::fmt::Display) -> Self {
        Self::new(Kind::NotFound, format!("no {what} {id}"))
    }

    /// It is there already; the message says where and what to do.
    pub fn exists(message: impl Into<String>) -> Self {
        Self::new(Kind::Exists, message)
    }

    /// Not now; the message says what must come first.
    pub fn precondition(message: impl Into<String>) -> Self {
        Self::new(Kind::Precondition, message)
    }

    /// A limit is reached; the message names it.
    pub fn exhausted(message: impl Into<String>) -> Self {
        Self::new(Kind::Exhausted, message)
    }

    /// Given up on purpose.
    pub fn cancelled(message: impl Into<String>) -> Self {
        Self::new(Kind::Cancelled, message)
    }

    /// Not in time; the message says what was waited for.
    pub fn late(message: impl Into<String>) -> Self {
        Self::new(Kind::Late, message)
    }

    /// Not ready, or going away.
    pub fn unavailable(message: impl Into<String>) -> Self {
        Self::new(Kind::Unavailable, message)
    }

    /// Our fault. `doing` says what was being done.
    pub fn internal(doing: impl Into<String>, source: impl Into<Box<dyn StdError + Send + Sync>>) -> Self {
        Self { kind: Kind::Internal, message: doing.into(), source: Some(source.into()) }
    }

    /// What an error of `learn` means to who asked for it. `doing` says what was being done.
    pub fn learned(doing: &str, error: LearnError) -> Self {
        match error {
            LearnError::Version { .. } | LearnError::Checkpoint(_) => Self::precondition(error.to_string()),
            LearnError::Invalid { ref field, ref message } => Self::invalid(field, message),
            LearnError::Cancelled => Self::cancelled(error.to_string()),
            LearnError::Diverged { .. } | LearnError::Monitor { .. } | LearnError::Torch(_) => {
                Self::internal(doing, error)
            }
        }
    }

    fn new(kind: Kind, message: impl Into<String>) -> Self {
        Self { kind, message: message.into(), source: None }
    }

    /// What kind of error this is.
    pub fn kind(&self) -> Kind {
        self.kind
    }

    /// The message, as the caller sees it (unless internal).
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

/// Runs `work` and turns a panic into an error: a fault of one call must not end the thread that serves all.
///
/// # Errors
/// What `work` says; Internal when it panics.
pub(crate) fn guarded<T>(doing: &str, work: impl FnOnce() -> Result<T>) -> Result<T> {
    // What the work had borrowed is only read, so nothing half-written is seen after a panic.
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|panic| {
        let text = panic
            .downcast_ref::<String>()
            .map(String::as_str)
            .or_else(|| panic.downcast_ref::<&str>().copied())
            .unwrap_or("a panic without a message");
        Err(Error::internal(doing, text))
    })
}
