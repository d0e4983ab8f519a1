//! Logging: one subscriber for the process.

use tracing_subscriber::EnvFilter;

/// Sends logs to standard error, as text or JSON lines.
///
/// # Errors
/// A sentence when the filter cannot be read or logging was set up before.
pub fn start(filter: &str, json: bool) -> Result<(), String> {
    let filter = EnvFilter::try_new(filter).map_err(|error| format!("--log {filter:?}: {error}"))?;
    let logs = tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr);
    let result = if json { logs.json().try_init() } else { logs.try_init() };
    result.map_err(|error| error.to_string())
}
