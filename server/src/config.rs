//! Configuration: flags and `GLEANER_…` variables, read once. The only module that reads the environment.

mod access;
mod blob_store;
mod children;
mod connections;
mod database;
mod engine;
mod maintenance;
mod openpi;
mod plan;
mod policies;
mod ranks;
mod telemetry;
mod tls;
mod uploads;

use std::{net::SocketAddr, path::PathBuf};

use clap::{Args, Parser, Subcommand};
use gleaner_inspector::RecordingsConfig;
use gleaner_logs::LogOptions;

pub use gleaner_core::Secret;

pub use self::{
    access::{AccessConfig, AuditConfig, NewTokenConfig, TokenCommand, TokenConfig},
    blob_store::BlobStoreConfig,
    children::{bucket_environment, cluster_environment, worker_environment},
    connections::ConnectionsConfig,
    database::DatabaseConfig,
    engine::{EngineConfig, EngineKind},
    maintenance::{
        BackupConfig, CheckConfig, MaintenanceCommand, MaintenanceConfig, MigrateConfig, RebuildConfig, RestoreConfig,
    },
    openpi::OpenpiConfig,
    plan::PlanConfig,
    policies::PoliciesConfig,
    ranks::RanksConfig,
    telemetry::TelemetryConfig,
    tls::{TlsClientConfig, TlsCommand, TlsConfig, TlsFolderConfig, TlsServerConfig},
    uploads::UploadsConfig,
};

/// Server of gleaner, which finds the good steps in failed robot demonstrations.
#[derive(Debug, Parser)]
#[command(name = "gleaner-server", version, propagate_version = true)]
pub struct Cli {
    /// What to run.
    #[command(subcommand)]
    pub command: Command,
    /// What to log.
    #[command(flatten)]
    pub log: LogOptions,
    /// Exit at a fail point: `name`, or `name=n` for its n-th passing (tests only).
    #[cfg(feature = "fail-points")]
    #[arg(long, env = gleaner_data_folder::fail_point::VARIABLE, hide = true, global = true)]
    pub fail_point: Option<String>,
}

/// The processes this binary can be.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Serve episodes, jobs, scores, datasets and policies.
    Serve(Box<ServeConfig>),
    /// Maintain a data folder.
    #[command(flatten)]
    Keep(MaintenanceCommand),
    /// Create, list and revoke access tokens.
    Token(TokenConfig),
    /// Create and renew TLS certificates.
    Tls(TlsConfig),
    /// Print the audit log: changes with their time, caller and result.
    Audit(AuditConfig),
    /// Compute what a lab needs of a server: network, disk, processors and memory, and which gives out first.
    Plan(PlanConfig),
}

/// What `serve` needs.
#[derive(Debug, Clone, Args)]
pub struct ServeConfig {
    /// Folder of the database, blobs and caches; created if missing.
    #[arg(long, env = "GLEANER_DATA_DIR", default_value = "gleaner-data", value_name = "DIR")]
    pub data_dir: PathBuf,
    /// Address for calls; port 0 selects a free port.
    #[arg(long, env = "GLEANER_LISTEN", default_value = "127.0.0.1:7400", value_name = "ADDRESS")]
    pub listen: SocketAddr,
    /// Allow an address that other machines can reach without TLS or without tokens. Anyone on that network may then
    /// read traffic or use the server.
    #[arg(long, env = "GLEANER_INSECURE")]
    pub insecure: bool,
    /// Give open calls and sessions this many seconds to finish after the signal to stop, at most 3600 (0: close them
    /// at once).
    #[arg(long, env = "GLEANER_DRAIN_SECONDS", default_value_t = 20, value_name = "SECONDS")]
    pub drain_seconds: u64,
    /// The database.
    #[command(flatten)]
    pub database: DatabaseConfig,
    /// Tokens and TLS.
    #[command(flatten)]
    pub access: AccessConfig,
    /// Limits on messages, uploads and inspections.
    #[command(flatten)]
    pub limits: LimitConfig,
    /// Limits on connections and calls.
    #[command(flatten)]
    pub connections: ConnectionsConfig,
    /// Pages, metrics and traces.
    #[command(flatten)]
    pub telemetry: TelemetryConfig,
    /// Clients of openpi.
    #[command(flatten)]
    pub openpi: OpenpiConfig,
    /// Limits on unfinished uploads.
    #[command(flatten)]
    pub uploads: UploadsConfig,
    /// Where blobs are stored.
    #[command(flatten)]
    pub blob_store: BlobStoreConfig,
    /// Retention and disk space.
    #[command(flatten)]
    pub maintenance: MaintenanceConfig,
    /// Workers.
    #[command(flatten)]
    pub jobs: JobsConfig,
    /// Serving of policies.
    #[command(flatten)]
    pub policies: PoliciesConfig,
}

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
    /// add a second. Recordings that need more are rejected.
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

/// Workers.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Jobs")]
pub struct JobsConfig {
    /// Maximum number of jobs that run at once, one worker process each (0: jobs are queued and do not run).
    #[arg(long, env = "GLEANER_WORKERS", default_value_t = 1, value_name = "N")]
    pub workers: usize,
    /// Compute threads of one worker; a training uses one more for its batches. More threads finish a job sooner and
    /// leave fewer processors for serving; results are reproducible for a fixed number.
    #[arg(long, env = "GLEANER_WORKER_THREADS", default_value_t = 2, value_name = "N")]
    pub worker_threads: u32,
    /// Niceness of workers. A higher value slows jobs down in favour of serving (0: the server's own priority).
    #[arg(long, env = "GLEANER_WORKER_NICE", default_value_t = 10, value_name = "NICE")]
    pub worker_nice: i32,
    /// Run compute threads of jobs at idle priority (SCHED_IDLE), so that serving preempts them at once; niceness alone
    /// lets them finish a slice of a few milliseconds. Jobs stall beside programs that use every processor; `false`
    /// gives them a share.
    #[arg(long, env = "GLEANER_WORKER_IDLE", default_value_t = true, action = clap::ArgAction::Set, value_name = "BOOL")]
    pub worker_idle: bool,
    /// Folder of pretrained weights that jobs name by `image_weights`: safetensors files of up to 256 MiB, as
    /// `scripts/convert_resnet.py` writes them. A job gets a copy when it is submitted. Without a folder such jobs are
    /// rejected.
    #[arg(long, env = "GLEANER_IMAGE_WEIGHTS_DIR", value_name = "DIR")]
    pub image_weights_dir: Option<PathBuf>,
    /// End a job's attempt when its worker has not reported for this many seconds. Lower values detect stuck workers
    /// sooner but end attempts on a machine that is overloaded.
    #[arg(long, env = "GLEANER_WORKER_SILENCE_SECONDS", default_value_t = 120, value_name = "SECONDS")]
    pub worker_silence_seconds: u64,
    /// The processes of a training.
    #[command(flatten)]
    pub ranks: RanksConfig,
    /// Where jobs run.
    #[command(flatten)]
    pub engine: EngineConfig,
}

impl Cli {
    /// Has this process die at the fail point of its configuration, if that names one.
    ///
    /// # Errors
    /// A sentence that names the mistake.
    pub fn arm_fail_point(&self) -> Result<(), String> {
        #[cfg(feature = "fail-points")]
        if let Some(which) = &self.fail_point {
            return gleaner_data_folder::fail_point::arm(which, None);
        }
        Ok(())
    }
}

impl ServeConfig {
    /// Checks ranges, and fields against each other.
    ///
    /// # Errors
    /// A sentence that names the flag and the fix.
    pub fn validate(&self) -> Result<(), String> {
        self.access.validate(self.listen, self.insecure)?;
        self.database.validate()?;
        if self.limits.max_message_bytes < 4 << 20 {
            return Err("--max-message-bytes: must be at least 4194304 for uploads and images to fit".to_owned());
        }
        if self.drain_seconds > 3600 {
            return Err("--drain-seconds: must be at most 3600".to_owned());
        }
        self.connections.validate()?;
        self.telemetry.validate(self.access.tls_cert.is_some())?;
        self.openpi.validate(self.access.tls_cert.is_some(), self.insecure)?;
        self.limits.recordings.validate()?;
        self.blob_store.validate()?;
        self.maintenance.validate()?;
        self.jobs.validate()?;
        self.jobs.engine.validate(self.access.tls_cert.is_some(), self.insecure)?;
        self.policies.validate()
    }
}

impl JobsConfig {
    fn validate(&self) -> Result<(), String> {
        match &self.image_weights_dir {
            Some(folder) if !folder.is_dir() => Err(format!(
                "--image-weights-dir: {} is not a folder; create it, or leave the flag out",
                folder.display()
            )),
            Some(_) | None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    fn serve(args: &[&str]) -> ServeConfig {
        let all = [&["gleaner-server", "serve"], args].concat();
        match Cli::try_parse_from(all).unwrap().command {
            Command::Serve(config) => *config,
            Command::Keep(_) | Command::Token(_) | Command::Tls(_) | Command::Audit(_) | Command::Plan(_) => {
                panic!("not serve")
            }
        }
    }

    #[test]
    fn definition_is_valid() {
        Cli::command().debug_assert();
    }

    #[test]
    fn public_address_without_insecure_is_rejected() {
        assert!(serve(&[]).validate().is_ok());
        assert!(serve(&["--listen", "0.0.0.0:7400"]).validate().unwrap_err().contains("--insecure"));
        assert!(serve(&["--listen", "0.0.0.0:7400", "--insecure"]).validate().is_ok());
    }

    #[test]
    fn public_pages_require_tls_or_web_insecure() {
        let open = ["--web-listen", "0.0.0.0:7401"];
        assert!(serve(&open).validate().unwrap_err().contains("--web-insecure"));
        assert!(serve(&[&open[..], &["--insecure"]].concat()).validate().is_err(), "--insecure applies to calls only");
        let config = serve(&[&open[..], &["--web-insecure"]].concat());
        assert_eq!(config.validate(), Ok(()));
        assert!(!config.insecure && config.access.tokens_required(false, config.insecure));
        assert_eq!(serve(&[&open[..], &["--tls-cert", "c", "--tls-key", "k"]].concat()).validate(), Ok(()));
    }

    #[test]
    fn settings_out_of_range_are_rejected() {
        for (flag, value) in [
            ("--policy-batch", "0"),
            ("--policy-batch-wait", "0.6"),
            ("--policy-batch-wait", "NaN"),
            ("--policy-spin-us", "100001"),
            ("--session-idle-seconds", "0"),
            ("--drain-seconds", "3601"),
            ("--image-weights-dir", "/dev/null"),
        ] {
            let problem = serve(&[flag, value]).validate().unwrap_err();
            assert!(problem.contains(flag), "{problem}");
        }
    }

    #[test]
    fn debug_hides_secrets() {
        assert_eq!(format!("{:?}", Secret::from("token".to_owned())), "(secret)");
    }
}
