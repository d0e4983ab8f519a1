//! The error of the crate: input of the wrong shape.

/// Input that cannot be searched.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{field}: {message}")]
pub struct SearchError {
    /// The argument that is wrong.
    pub field: &'static str,
    /// The fault of the argument, and its allowed form.
    pub message: String,
}

impl SearchError {
    pub(crate) fn new(field: &'static str, message: impl Into<String>) -> Self {
        Self { field, message: message.into() }
    }
}
