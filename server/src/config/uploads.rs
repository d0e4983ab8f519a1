//! How long unfinished uploads are kept.

use std::time::Duration;

use clap::Args;

/// How long unfinished uploads are kept.
#[derive(Debug, Clone, Args)]
pub struct UploadsConfig {
    /// Days that an upload nobody goes on with is kept; then the sweep forgets it.
    #[arg(long, env = "GLEANER_KEEP_UPLOADS_DAYS", default_value_t = 14, value_parser = clap::value_parser!(u32).range(1..))]
    pub keep_uploads_days: u32,
}

impl UploadsConfig {
    /// The same as a duration.
    pub(crate) fn keep_for(&self) -> Duration {
        Duration::from_secs(u64::from(self.keep_uploads_days) * 24 * 60 * 60)
    }
}
