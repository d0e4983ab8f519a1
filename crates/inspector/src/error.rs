//! The error of an inspection. A problem of the recording is a verdict, not an error.

/// The inspection itself failed.
#[derive(Debug, thiserror::Error)]
#[error("{doing}: {source}")]
pub struct InspectError {
    doing: &'static str,
    source: std::io::Error,
}

impl InspectError {
    /// Wraps the cause of an error, for `map_err`.
    pub(crate) fn when<E: Into<std::io::Error>>(doing: &'static str) -> impl Fn(E) -> Self {
        move |source| Self { doing, source: source.into() }
    }
}
