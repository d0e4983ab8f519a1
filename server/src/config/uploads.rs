//! Limits on unfinished uploads.

use std::time::Duration;

use clap::Args;

/// Limits on unfinished uploads.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Uploads")]
pub struct UploadsConfig {
    /// Keep unfinished uploads for this many days after their last byte, at least 1; then the sweep removes them.
    #[arg(long, env = "GLEANER_KEEP_UPLOADS_DAYS", default_value_t = 14, value_name = "DAYS",
          value_parser = clap::value_parser!(u32).range(1..))]
    pub keep_uploads_days: u32,
    /// Maximum number of unfinished uploads of one token, or of one address without a token. A low limit bounds the
    /// disk space of abandoned uploads; with a high one many machines behind one address can push at once (0: no limit).
    #[arg(long, env = "GLEANER_MAX_OPEN_UPLOADS_PER_CALLER", default_value_t = 1000, value_name = "N")]
    pub max_open_uploads_per_caller: u64,
}

impl UploadsConfig {
    /// The limit on unfinished uploads of one client, if any.
    pub(crate) fn max_open_per_client(&self) -> Option<u64> {
        (self.max_open_uploads_per_caller > 0).then_some(self.max_open_uploads_per_caller)
    }

    /// The time for which they are kept.
    pub(crate) fn keep_for(&self) -> Duration {
        Duration::from_secs(u64::from(self.keep_uploads_days) * 24 * 60 * 60)
    }
}
