//! Why there is no verdict. What is wrong with a recording is a verdict, not an error.

/// The inspection itself failed.
#[derive(Debug, thiserror::Error)]
#[error("{doing}: {source}")]
pub struct InspectError {
    doing: &'static str,
    source: std::io::Error,
}

impl InspectError {
    /// What makes one of an error's cause, for `map_err`.
    pub(crate) fn when<E: Into<std::io::Error>>(doing: &'static str) -> impl Fn(E) -> Self {
        move |source| Self { doing, source: source.into() }
    }
}
