//! The error of the search: input of the wrong shape.

/// Input that cannot be searched.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{field}: {message}")]
pub struct SearchError {
    /// The argument that is wrong.
    pub field: &'static str,
    /// What is wrong with it and what would be right.
    pub message: String,
}

impl SearchError {
    pub(crate) fn new(field: &'static str, message: impl Into<String>) -> Self {
        Self { field, message: message.into() }
    }
}
