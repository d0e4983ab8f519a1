//! The worker process: one job, then it ends. A client of the server that started it.

use crate::{config::WorkerConfig, error::{Error, Result}};

/// Runs one job to its end.
///
/// # Errors
/// When the server cannot be reached or the job fails.
pub fn run(config: WorkerConfig) -> Result<()> {
    let _ = config;
    Err(Error::unavailable("not there yet"))
}
