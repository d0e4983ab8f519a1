//! What the commands that look after a data folder need.

use std::path::PathBuf;

use clap::{Args, Subcommand};

/// How long what nobody wants is kept, and what the disk is spared.
#[derive(Debug, Clone, Args)]
pub struct MaintenanceConfig {
    /// Days that a deleted episode can be taken back, before the sweep removes it for good.
    #[arg(long, env = "GLEANER_TRASH_DAYS", default_value_t = 30, value_name = "DAYS")]
    pub trash_days: u32,
    /// Days that what the workers of a job said is kept.
    #[arg(long = "keep-logs-days", env = "GLEANER_KEEP_LOGS_DAYS", default_value_t = 90, value_name = "DAYS")]
    pub log_days: u32,
    /// Days that the audit log remembers; unless given, for ever.
    #[arg(long = "keep-audit-days", env = "GLEANER_KEEP_AUDIT_DAYS", value_name = "DAYS")]
    pub audit_days: Option<u32>,
    /// Days that segments' features are kept that no score job has used; then they are encoded again when one needs them.
    #[arg(long = "keep-features-days", env = "GLEANER_KEEP_FEATURES_DAYS", default_value_t = 7, value_name = "DAYS")]
    pub features_days: u32,
    /// Most bytes that the decoded steps of recordings and the features of their segments may take, looked at once an
    /// hour: beyond, features and at last steps go that were not used for longest, and are made again when somebody needs
    /// them. Unless given, any number.
    #[arg(long, env = "GLEANER_MAX_CACHE_BYTES", value_name = "BYTES")]
    pub max_cache_bytes: Option<u64>,
    /// Largest share of the blobs (0 to 1) that one sweep may move to the trash as recordings and results without a row. A
    /// sweep that finds more, and more than 8, removes nothing and logs an error. 0: never more than 8; 1: no limit.
    #[arg(long, env = "GLEANER_MAX_SWEEP_SHARE", default_value_t = 0.05, value_name = "SHARE")]
    pub max_sweep_share: f64,
    /// Start once with a database that is missing, older than the blobs or another folder's. Blobs that it does not name
    /// move to the trash; recordings stay there until `gleaner-server rebuild` takes them back or a person deletes them.
    #[arg(long)]
    pub accept_database: bool,
    /// Bytes of the disk that stay free: below, nothing new is taken in, until there is room again.
    #[arg(long, env = "GLEANER_MIN_FREE_BYTES", default_value_t = 512 << 20, value_name = "BYTES")]
    pub min_free_bytes: u64,
}

/// The commands that look after a data folder, beside a running server or without one.
#[derive(Debug, Clone, Subcommand)]
pub enum MaintenanceCommand {
    /// Check that everything in a data folder, or a backup, is there and is what it was.
    Check(CheckConfig),
    /// Back a data folder up, beside a running server or without one.
    Backup(BackupConfig),
    /// Make a new data folder from a backup.
    Restore(RestoreConfig),
    /// Make a lost database again from the blobs, or add to an older one what the blobs know.
    Rebuild(RebuildConfig),
}

/// Settings of `rebuild`.
#[derive(Debug, Clone, Args)]
pub struct RebuildConfig {
    /// The data folder. No server may be running on it.
    #[arg(long, env = "GLEANER_DATA_DIR", default_value = "gleaner-data")]
    pub data_dir: PathBuf,
    /// Compare sizes only, without reading each recording to check its digest.
    #[arg(long)]
    pub fast: bool,
}

/// What `backup` needs.
#[derive(Debug, Clone, Args)]
pub struct BackupConfig {
    /// The folder of the backup: a new one, or that of an earlier backup, to which only what is new is added.
    #[arg(value_name = "DIR")]
    pub target: PathBuf,
    /// The data folder. A server may be running on it.
    #[arg(long, env = "GLEANER_DATA_DIR", default_value = "gleaner-data")]
    pub data_dir: PathBuf,
    /// Read what an earlier backup has, too, and copy again what is not what its name says. Without it only its size is
    /// looked at.
    #[arg(long)]
    pub verify: bool,
    /// Afterwards remove from the backup the blobs that its new database no longer names.
    #[arg(long)]
    pub prune: bool,
}

/// What `restore` needs.
#[derive(Debug, Clone, Args)]
pub struct RestoreConfig {
    /// The backup.
    #[arg(value_name = "DIR")]
    pub backup: PathBuf,
    /// The new data folder: not there yet, or empty.
    #[arg(long)]
    pub data_dir: PathBuf,
}

/// What `check` needs.
#[derive(Debug, Clone, Args)]
pub struct CheckConfig {
    /// The data folder, or a backup. A server may be running on it.
    #[arg(long, env = "GLEANER_DATA_DIR", default_value = "gleaner-data")]
    pub data_dir: PathBuf,
    /// ReadOnlyDatabase whether blobs are there with the right size, without reading them.
    #[arg(long)]
    pub fast: bool,
    /// Tell what was found as JSON.
    #[arg(long)]
    pub json: bool,
}

impl MaintenanceConfig {
    /// Checks what the types cannot.
    ///
    /// # Errors
    /// A sentence that names the flag and the remedy.
    pub(super) fn validate(&self) -> Result<(), String> {
        match self.max_sweep_share {
            share if (0.0..=1.0).contains(&share) => Ok(()),
            share => Err(format!("--max-sweep-share {share}: must be between 0 and 1")),
        }
    }
}
