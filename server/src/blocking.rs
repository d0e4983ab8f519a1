//! Work that blocks, such as reading a file. Independent of what the work is.

use crate::error::{Error, Result};

/// Runs blocking work off the runtime's threads.
///
/// # Errors
/// Those of `work`; Internal, with what was being done, if it panicked.
pub(crate) async fn off_runtime<T: Send + 'static>(
    doing: &'static str,
    work: impl FnOnce() -> Result<T> + Send + 'static,
) -> Result<T> {
    tokio::task::spawn_blocking(work).await.map_err(|error| Error::internal(doing, error))?
}
