//! How many unfinished uploads a caller may have, and how long they are kept.

use std::time::Duration;

use clap::Args;

/// How many unfinished uploads a caller may have, and how long they are kept.
#[derive(Debug, Clone, Args)]
pub struct UploadsConfig {
    /// Days that an upload nobody goes on with is kept; then the sweep forgets it.
    #[arg(long, env = "GLEANER_KEEP_UPLOADS_DAYS", default_value_t = 14, value_parser = clap::value_parser!(u32).range(1..))]
    pub keep_uploads_days: u32,
    /// Limit on unfinished uploads of one token, or of one address without tokens. A low limit bounds what abandoned
    /// uploads take of the disk; a high one lets many machines behind one address push at once (0: no limit).
    #[arg(long, env = "GLEANER_MAX_OPEN_UPLOADS_PER_CALLER", default_value_t = 1000, value_name = "N")]
    pub max_open_uploads_per_caller: u64,
}

impl UploadsConfig {
    /// The limit on unfinished uploads of one client, if there is one.
    pub(crate) fn max_open_per_client(&self) -> Option<u64> {
        (self.max_open_uploads_per_caller > 0).then_some(self.max_open_uploads_per_caller)
    }

    /// How long they are kept, as a duration.
    pub(crate) fn keep_for(&self) -> Duration {
        Duration::from_secs(u64::from(self.keep_uploads_days) * 24 * 60 * 60)
    }
}
