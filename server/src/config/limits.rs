//! Limits on messages, uploads and inspections.

use clap::Args;
use gleaner_inspector::RecordingsConfig;

/// Limits on messages, uploads and inspections.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Limits")]
pub struct LimitConfig {
    /// Maximum size of a gRPC message in bytes, at least 4194304. A lower limit bounds the size of snapshots and
    /// observations; with a higher one a single call can use more memory.
    #[arg(long, env = "GLEANER_MAX_MESSAGE_BYTES", default_value_t = 32 << 20, value_name = "BYTES")]
    pub max_message_bytes: usize,
    /// Maximum size of a recording in bytes. Larger recordings are rejected before their upload.
    #[arg(long, env = "GLEANER_MAX_UPLOAD_BYTES", default_value_t = 8 << 30, value_name = "BYTES")]
    pub max_upload_bytes: u64,
    /// Maximum memory of one inspection in bytes, and beside 16 times the recording's size the most that its decoded
    /// images take on disk. Memory follows the number of messages and not of pixels. Recordings that need more are
    /// rejected.
    #[arg(long, env = "GLEANER_INSPECT_MEMORY_BYTES", default_value_t = 2 << 30, value_name = "BYTES")]
    pub inspect_memory_bytes: u64,
    /// Maximum time of one inspection in seconds, for processor time and wall clock each; each 512 KiB of the recording
    /// add a second, and each 4 million pixels of its pictures add one, these at most 6 hours. Recordings that need more are
    /// rejected.
    #[arg(long, env = "GLEANER_INSPECT_SECONDS", default_value_t = 120, value_name = "SECONDS")]
    pub inspect_seconds: u64,
    /// Maximum number of inspections at once, shared fairly between callers: above 1, one caller gets at most all but
    /// one. More inspections at once use more processors and memory (0: as 1).
    #[arg(long, env = "GLEANER_INSPECT_PARALLEL", default_value_t = 3, value_name = "N")]
    pub inspect_parallel: usize,
    /// Threads that decode the images of one inspection (0: the processors, shared between `--inspect-parallel`). More
    /// threads shorten the inspection of a recording with images; all count towards its processor time.
    #[arg(long, env = "GLEANER_INSPECT_THREADS", default_value_t = 0, value_name = "N")]
    pub inspect_threads: usize,
    /// Maximum number of concurrent calls on one connection; further ones wait in the client.
    #[arg(long, env = "GLEANER_MAX_STREAMS", default_value_t = 256, value_name = "N")]
    pub max_streams: u32,
    /// Limits on the content of a recording.
    #[command(flatten)]
    pub recordings: RecordingsConfig,
}

impl LimitConfig {
    /// Checks ranges.
    ///
    /// # Errors
    /// A sentence that names the flag and the range.
    pub(super) fn validate(&self) -> Result<(), String> {
        if self.max_message_bytes < 4 << 20 {
            return Err("--max-message-bytes: must be at least 4194304 for uploads and images to fit".to_owned());
        }
        self.recordings.validate()
    }
}
