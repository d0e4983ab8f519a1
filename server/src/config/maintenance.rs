//! Retention settings, and the arguments of the commands that maintain a data folder.

use std::path::PathBuf;

use clap::{Args, Subcommand};
use gleaner_core::Secret;

use super::DatabaseConfig;

/// Retention and disk space.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Retention and disk")]
pub struct MaintenanceConfig {
    /// Keep deleted episodes restorable for this many days before the sweep removes them (0: until the next sweep).
    #[arg(long, env = "GLEANER_TRASH_DAYS", default_value_t = 30, value_name = "DAYS")]
    pub trash_days: u32,
    /// Keep the workers' output of a job for this many days after its last line.
    #[arg(long = "keep-logs-days", env = "GLEANER_KEEP_LOGS_DAYS", default_value_t = 90, value_name = "DAYS")]
    pub log_days: u32,
    /// Keep the files of an export for this many days after it was made (0: forever). Longer lets clients fetch them again
    /// without a job, shorter saves disk space. While the recordings of its dataset are there, it can be made again.
    #[arg(long = "keep-exports-days", env = "GLEANER_KEEP_EXPORTS_DAYS", default_value_t = 30, value_name = "DAYS")]
    pub export_days: u32,
    /// Keep audit entries for this many days. Default: forever.
    #[arg(long = "keep-audit-days", env = "GLEANER_KEEP_AUDIT_DAYS", value_name = "DAYS")]
    pub audit_days: Option<u32>,
    /// Keep features of segments for this many days after their last use by a score job. Longer saves encoding, shorter
    /// saves disk space.
    #[arg(long = "keep-features-days", env = "GLEANER_KEEP_FEATURES_DAYS", default_value_t = 7, value_name = "DAYS")]
    pub features_days: u32,
    /// Maximum size of the cache in bytes: features of segments and decoded steps of recordings. Beyond it, or when the
    /// disk is short of space, the least recently used are removed, features first; both are rebuilt on demand. A larger
    /// cache saves that work and leaves less of the disk to other programs (0: no limit). Default: half of the disk.
    #[arg(long, env = "GLEANER_MAX_CACHE_BYTES", value_name = "BYTES")]
    pub max_cache_bytes: Option<u64>,
    /// Maximum share of all blobs, 0 to 1, that one sweep moves to the trash as recordings and results without a row. A
    /// sweep that finds more than this and more than 8 moves none, with an error in the log (0: at most 8; 1: no limit).
    #[arg(long, env = "GLEANER_MAX_SWEEP_SHARE", default_value_t = 0.05, value_name = "SHARE")]
    pub max_sweep_share: f64,
    /// Start once with a database that is missing, older than the blobs, from another folder, or a backup's. Blobs without
    /// a row move to the trash; recordings stay there until `gleaner-server rebuild` restores them or a person deletes them.
    #[arg(long)]
    pub accept_database: bool,
    /// Reject uploads, recordings of sessions and new jobs while fewer bytes of the disk are free (0: never). The
    /// reserve is for the database, which records the end of running work.
    #[arg(long, env = "GLEANER_MIN_FREE_BYTES", default_value_t = 512 << 20, value_name = "BYTES")]
    pub min_free_bytes: u64,
}

/// The commands that maintain a data folder.
#[derive(Debug, Clone, Subcommand)]
pub enum MaintenanceCommand {
    /// Check every row and digest of a data folder or backup, beside a running server or without one.
    Check(CheckConfig),
    /// Back up a data folder, beside a running server or without one.
    Backup(BackupConfig),
    /// Create a new data folder from a backup.
    Restore(RestoreConfig),
    /// Restore a lost database from the sidecars of the blobs, or complete an older one. Needs a stopped server.
    Rebuild(RebuildConfig),
    /// Move the database between SQLite and PostgreSQL, compared row by row. Needs a stopped server.
    Migrate(MigrateConfig),
}

/// Arguments of `rebuild`.
#[derive(Debug, Clone, Args)]
pub struct RebuildConfig {
    /// Data folder of a stopped server.
    #[arg(long, env = "GLEANER_DATA_DIR", default_value = "gleaner-data", value_name = "DIR")]
    pub data_dir: PathBuf,
    /// Compare sizes only; skips the digests, which takes less time and misses changed bytes.
    #[arg(long)]
    pub fast: bool,
    /// The database.
    #[command(flatten)]
    pub database: DatabaseConfig,
}

/// Arguments of `migrate`.
#[derive(Debug, Clone, Args)]
pub struct MigrateConfig {
    /// The new database, which must be empty: postgres://USER@HOST:PORT/NAME for PostgreSQL, or `sqlite` for the file in
    /// the data folder, from the database that `--database` names.
    #[arg(long, value_name = "URL")]
    pub to: Secret,
    /// Data folder of a stopped server.
    #[arg(long, env = "GLEANER_DATA_DIR", default_value = "gleaner-data", value_name = "DIR")]
    pub data_dir: PathBuf,
    /// The database.
    #[command(flatten)]
    pub database: DatabaseConfig,
}

/// Arguments of `backup`.
#[derive(Debug, Clone, Args)]
pub struct BackupConfig {
    /// Folder of the backup: new, or of an earlier backup, which receives new files only.
    #[arg(value_name = "DIR")]
    pub target: PathBuf,
    /// Data folder of the server, which may be running.
    #[arg(long, env = "GLEANER_DATA_DIR", default_value = "gleaner-data", value_name = "DIR")]
    pub data_dir: PathBuf,
    /// Verify the digests of the earlier backup's files and copy damaged ones again. Without it only sizes are
    /// compared.
    #[arg(long)]
    pub verify: bool,
    /// After the backup, remove its blobs without a row in its new database.
    #[arg(long)]
    pub prune: bool,
    /// The database.
    #[command(flatten)]
    pub database: DatabaseConfig,
}

/// Arguments of `restore`.
#[derive(Debug, Clone, Args)]
pub struct RestoreConfig {
    /// Folder of the backup.
    #[arg(value_name = "DIR")]
    pub backup: PathBuf,
    /// The new data folder, which must be missing or empty.
    #[arg(long, value_name = "DIR")]
    pub data_dir: PathBuf,
    /// The database, for the backup of one in PostgreSQL: a new and empty one.
    #[command(flatten)]
    pub database: DatabaseConfig,
}

/// Arguments of `check`.
#[derive(Debug, Clone, Args)]
pub struct CheckConfig {
    /// Data folder, whose server may be running, or a backup.
    #[arg(long, env = "GLEANER_DATA_DIR", default_value = "gleaner-data", value_name = "DIR")]
    pub data_dir: PathBuf,
    /// Compare sizes only; skips the digests, which takes less time and misses changed bytes.
    #[arg(long)]
    pub fast: bool,
    /// Print the findings as JSON.
    #[arg(long)]
    pub json: bool,
    /// The database.
    #[command(flatten)]
    pub database: DatabaseConfig,
}

impl MaintenanceConfig {
    /// Checks ranges.
    ///
    /// # Errors
    /// A sentence that names the flag and the range.
    pub(super) fn validate(&self) -> Result<(), String> {
        match self.max_sweep_share {
            share if (0.0..=1.0).contains(&share) => Ok(()),
            share => Err(format!("--max-sweep-share {share}: must be between 0 and 1")),
        }
    }
}
