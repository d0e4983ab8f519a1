//! The error type of the crate. Independent of status codes and callers.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};

use gleaner_core::{Error, Problem};
use gleaner_group::GroupError;
use gleaner_search::SearchError;
use safetensors::SafeTensorError;
use tch::TchError;

/// The reason why the steps of an episode could not be read.
pub type SourceError = Box<dyn std::error::Error + Send + Sync>;

/// Reason why a call into this crate failed.
#[derive(Debug, thiserror::Error)]
pub enum LearnError {
    /// The caller's input is wrong; `field` names it, and `message` is what to change.
    #[error("{field}: {message}")]
    Invalid {
        /// Path of the field, such as `learning_rate` or `episode ep_1: action`.
        field: String,
        /// The fault, and the allowed values.
        message: String,
    },
    /// The bytes are not a checkpoint this crate can use.
    #[error("checkpoint: {0}")]
    Checkpoint(String),
    /// The checkpoint was written in another format.
    #[error(
        "checkpoint: format version {found} cannot be read, this program reads version {supported}; \
         train it again, or use the release that wrote it"
    )]
    Version {
        /// The version in the file.
        found: u32,
        /// The version this program writes and reads.
        supported: u32,
    },
    /// [`Monitor::cancelled`](crate::Monitor::cancelled) returned true.
    #[error("cancelled")]
    Cancelled,
    /// The loss is no longer a number.
    #[error("the loss is not finite at step {step}; use a lower learning_rate")]
    Diverged {
        /// The step (from 0) whose loss was not finite.
        step: u64,
    },
    /// The monitor failed to store a checkpoint.
    #[error("the checkpoint of step {step} could not be kept: {message}")]
    Monitor {
        /// Steps done.
        step: u64,
        /// The monitor's error.
        message: String,
    },
    /// The steps of an episode could not be read.
    #[error("episode {episode} cannot be read: {source}")]
    Steps {
        /// The episode's id.
        episode: String,
        /// The reason.
        source: SourceError,
    },
    /// The system started no thread to assemble batches.
    #[error(
        "no thread could be started to assemble batches: {0}; run fewer jobs at once or raise the limit on threads"
    )]
    Thread(std::io::Error),
    /// Another process of the job is lost.
    #[error("{0}")]
    Group(#[from] GroupError),
    /// Another process of the job sent a result that this one cannot read.
    #[error("another rank sent a result of another form; run the same release on every node")]
    Exchange,
    /// The tensor library failed: out of memory, or a defect here.
    #[error("tensor library: {0}")]
    Torch(String),
}

impl LearnError {
    /// The error for the caller of the server or the worker. `doing` names the failed operation for the log.
    pub fn during(self, doing: &str) -> Error {
        match self {
            Self::Version { .. } | Self::Checkpoint(_) => Error::precondition(self.to_string()),
            Self::Invalid { ref field, ref message } => Error::invalid(field, message),
            Self::Cancelled => Error::cancelled(self.to_string()),
            Self::Diverged { .. }
            | Self::Monitor { .. }
            | Self::Steps { .. }
            | Self::Thread(_)
            | Self::Group(_)
            | Self::Exchange
            | Self::Torch(_) => Error::internal(doing, self),
        }
    }

    /// An [`LearnError::Invalid`] for `field`.
    pub(crate) fn invalid(field: impl Into<String>, message: impl Into<String>) -> Self {
        Self::Invalid { field: field.into(), message: message.into() }
    }
}

impl From<Problem> for LearnError {
    fn from(Problem { field, message }: Problem) -> Self {
        Self::Invalid { field, message }
    }
}

/// Fails with `field` unless `low <= value <= high`; a value that is not a number fails too.
pub(crate) fn within(field: &str, value: f64, low: f64, high: f64) -> Result<(), LearnError> {
    if (low..=high).contains(&value) {
        return Ok(());
    }
    Err(LearnError::invalid(field, format!("is {value}, must be between {low} and {high}")))
}

impl From<TchError> for LearnError {
    fn from(error: TchError) -> Self {
        Self::Torch(first_line(&error.to_string()))
    }
}

impl From<SearchError> for LearnError {
    fn from(error: SearchError) -> Self {
        Self::invalid(error.field, error.message)
    }
}

impl From<SafeTensorError> for LearnError {
    fn from(error: SafeTensorError) -> Self {
        Self::Checkpoint(format!("{error}; the bytes are cut short or are not a checkpoint"))
    }
}

/// Runs `work` and turns a panic of the tensor library into [`LearnError::Torch`].
///
/// Plain tensor operations panic when the library throws. Inputs are checked before, so the remaining causes are
/// exhausted memory or a defect; neither may end the caller's thread.
pub(crate) fn guard<T>(work: impl FnOnce() -> Result<T, LearnError>) -> Result<T, LearnError> {
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|panic| Err(from_panic(panic.as_ref())))
}

fn from_panic(panic: &(dyn Any + Send)) -> LearnError {
    let text = panic
        .downcast_ref::<String>()
        .map(String::as_str)
        .or_else(|| panic.downcast_ref::<&str>().copied())
        .unwrap_or("panic without a message");
    LearnError::Torch(first_line(text))
}

/// The library appends its C++ stack to a message; only the first line is useful to the reader.
fn first_line(text: &str) -> String {
    text.lines().next().unwrap_or_default().to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_of_the_tensor_library_becomes_an_error() {
        let result: Result<(), _> = guard(|| {
            let a = tch::Tensor::from_slice(&[1.0f32, 2.0]);
            let b = tch::Tensor::from_slice(&[1.0f32, 2.0, 3.0]);
            let _ = a + b;
            Ok(())
        });
        let message = result.unwrap_err().to_string();
        assert!(message.starts_with("tensor library: "), "{message}");
        assert!(!message.contains('\n'), "{message}");
    }
}
