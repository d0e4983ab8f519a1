//! Configuration: flags and `GLEANER_…` variables, read once. The only room that reads the environment.

mod access;
mod children;
mod connections;
mod maintenance;
mod policies;
mod telemetry;
mod tls;
mod uploads;

use std::{net::SocketAddr, path::PathBuf};

use clap::{Args, Parser, Subcommand};
use gleaner_inspector::RecordingsConfig;

pub use self::{
    access::{AccessConfig, AuditConfig, NewTokenConfig, TokenCommand, TokenConfig},
    children::{WorkerConfig, worker_environment},
    connections::ConnectionsConfig,
    maintenance::{BackupConfig, CheckConfig, MaintenanceCommand, MaintenanceConfig, RebuildConfig, RestoreConfig},
    policies::PoliciesConfig,
    telemetry::TelemetryConfig,
    tls::{TlsClientConfig, TlsCommand, TlsConfig, TlsFolderConfig, TlsServerConfig},
    uploads::UploadsConfig,
};

/// gleans the good steps out of failed robot demonstrations.
#[derive(Debug, Parser)]
#[command(name = "gleaner-server", version, propagate_version = true)]
pub struct Cli {
    /// What to run.
    #[command(subcommand)]
    pub command: Command,
    /// What to log, as a tracing filter.
    #[arg(long, env = "GLEANER_LOG", default_value = "info", global = true)]
    pub log: String,
    /// Log as JSON lines.
    #[arg(long, env = "GLEANER_LOG_JSON", global = true)]
    pub log_json: bool,
    /// Die at a fail point: `name`, or `name=n` for its n-th passing (tests only).
    #[cfg(feature = "fail-points")]
    #[arg(long, env = FAIL_POINT, hide = true, global = true)]
    pub fail_point: Option<String>,
}

/// Where the tests name a fail point; workers get it too.
#[cfg(feature = "fail-points")]
const FAIL_POINT: &str = "GLEANER_FAIL_POINT";

/// The processes this binary can be.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Serve episodes, jobs, scores, datasets and policies.
    Serve(Box<ServeConfig>),
    /// ReadOnlyDatabase after a data folder.
    #[command(flatten)]
    Keep(MaintenanceCommand),
    /// Make, list and revoke the tokens that let callers in.
    Token(TokenConfig),
    /// Make and renew certificates for encrypted connections.
    Tls(TlsConfig),
    /// Show who changed what.
    Audit(AuditConfig),
    /// Run one job (started by `serve`, not by hand).
    #[command(hide = true)]
    Worker(WorkerConfig),
}

/// What `serve` needs.
#[derive(Debug, Clone, Args)]
pub struct ServeConfig {
    /// Where the database, blobs and caches live; created if missing.
    #[arg(long, env = "GLEANER_DATA_DIR", default_value = "gleaner-data")]
    pub data_dir: PathBuf,
    /// Address to listen on; port 0 takes any free port.
    #[arg(long, env = "GLEANER_LISTEN", default_value = "127.0.0.1:7400")]
    pub listen: SocketAddr,
    /// Listen on an address other machines can reach although the line is not encrypted, or nobody is asked who they are.
    #[arg(long, env = "GLEANER_INSECURE")]
    pub insecure: bool,
    /// Seconds that open calls and sessions may go on once the server begins to stop.
    #[arg(long, env = "GLEANER_DRAIN_SECONDS", default_value_t = 20)]
    pub drain_seconds: u64,
    /// Who is let in, and how the line is encrypted.
    #[command(flatten)]
    pub access: AccessConfig,
    /// Limits on what comes in.
    #[command(flatten)]
    pub limits: LimitConfig,
    /// How much of the server one peer may take.
    #[command(flatten)]
    pub connections: ConnectionsConfig,
    /// Where the server tells of itself.
    #[command(flatten)]
    pub telemetry: TelemetryConfig,
    /// How many unfinished uploads a caller may have, and how long they are kept.
    #[command(flatten)]
    pub uploads: UploadsConfig,
    /// How long what nobody wants is kept, and what the disk is spared.
    #[command(flatten)]
    pub maintenance: MaintenanceConfig,
    /// How jobs run.
    #[command(flatten)]
    pub jobs: JobsConfig,
    /// How policies are served.
    #[command(flatten)]
    pub policies: PoliciesConfig,
}

/// Limits on what comes in.
#[derive(Debug, Clone, Args)]
pub struct LimitConfig {
    /// Largest gRPC message, in bytes.
    #[arg(long, env = "GLEANER_MAX_MESSAGE_BYTES", default_value_t = 32 << 20)]
    pub max_message_bytes: usize,
    /// Largest recording, in bytes.
    #[arg(long, env = "GLEANER_MAX_UPLOAD_BYTES", default_value_t = 8 << 30)]
    pub max_upload_bytes: u64,
    /// Memory of the process that inspects a recording, in bytes.
    #[arg(long, env = "GLEANER_INSPECT_MEMORY_BYTES", default_value_t = 2 << 30)]
    pub inspect_memory_bytes: u64,
    /// Time of the process that inspects a recording, in seconds (processor and wall clock each).
    #[arg(long, env = "GLEANER_INSPECT_SECONDS", default_value_t = 120)]
    pub inspect_seconds: u64,
    /// Limit on recordings inspected at once, shared fairly between callers: above 1, one caller gets at most all but one.
    /// More inspections at once take more processors and memory.
    #[arg(long, env = "GLEANER_INSPECT_PARALLEL", default_value_t = 3)]
    pub inspect_parallel: usize,
    /// Concurrent streams of one connection.
    #[arg(long, env = "GLEANER_MAX_STREAMS", default_value_t = 256)]
    pub max_streams: u32,
    /// Limits on what a recording may hold.
    #[command(flatten)]
    pub recordings: RecordingsConfig,
}

/// How jobs run.
#[derive(Debug, Clone, Args)]
pub struct JobsConfig {
    /// Worker processes at once; 0 queues jobs without running them.
    #[arg(long, env = "GLEANER_WORKERS", default_value_t = 1)]
    pub workers: usize,
    /// Threads of one worker's tensor library.
    #[arg(long, env = "GLEANER_WORKER_THREADS", default_value_t = 2)]
    pub worker_threads: u32,
    /// Niceness of workers, so that training never slows serving.
    #[arg(long, env = "GLEANER_WORKER_NICE", default_value_t = 10)]
    pub worker_nice: i32,
    /// Whether the work of jobs gives way at once to whatever else of the server wants a processor (SCHED_IDLE): niceness
    /// alone lets it finish its slice of a few milliseconds first. Beside other programs that leave no time, jobs stand
    /// still; `false` gives them their part.
    #[arg(long, env = "GLEANER_WORKER_IDLE", default_value_t = true, action = clap::ArgAction::Set, value_name = "BOOL")]
    pub worker_idle: bool,
    /// Seconds without a word from a worker after which its attempt is over.
    #[arg(long, env = "GLEANER_WORKER_SILENCE_SECONDS", default_value_t = 120)]
    pub worker_silence_seconds: u64,
}

/// Text that must never reach a log.
#[derive(Clone)]
pub struct Secret(String);

impl Secret {
    /// The text itself: for the wire only.
    pub fn reveal(&self) -> &str {
        &self.0
    }
}

impl From<String> for Secret {
    fn from(text: String) -> Self {
        Self(text)
    }
}

impl std::str::FromStr for Secret {
    type Err = std::convert::Infallible;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        Ok(Self(text.to_owned()))
    }
}

impl std::fmt::Debug for Secret {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("(secret)")
    }
}

impl ServeConfig {
    /// Checks what one field alone cannot tell.
    ///
    /// # Errors
    /// A sentence that names the flag and the mend.
    pub fn validate(&self) -> Result<(), String> {
        self.access.validate(self.listen, self.insecure)?;
        if self.limits.max_message_bytes < 4 << 20 {
            return Err("--max-message-bytes: must be at least 4194304 for uploads and images to fit".to_owned());
        }
        if self.drain_seconds > 3600 {
            return Err("--drain-seconds: must be at most 3600".to_owned());
        }
        self.connections.validate()?;
        self.telemetry.validate(self.access.tls_cert.is_some())?;
        self.limits.recordings.validate()?;
        self.maintenance.validate()?;
        self.policies.validate()
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
            Command::Keep(_) | Command::Token(_) | Command::Tls(_) | Command::Audit(_) | Command::Worker(_) => {
                panic!("not serve")
            }
        }
    }

    #[test]
    fn the_definition_is_sound() {
        Cli::command().debug_assert();
    }

    #[test]
    fn an_open_address_needs_a_flag() {
        assert!(serve(&[]).validate().is_ok());
        assert!(serve(&["--listen", "0.0.0.0:7400"]).validate().unwrap_err().contains("--insecure"));
        assert!(serve(&["--listen", "0.0.0.0:7400", "--insecure"]).validate().is_ok());
    }

    #[test]
    fn pages_that_others_reach_are_encrypted_or_a_flag_of_their_own() {
        let open = ["--web-listen", "0.0.0.0:7401"];
        assert!(serve(&open).validate().unwrap_err().contains("--web-insecure"));
        assert!(serve(&[&open[..], &["--insecure"]].concat()).validate().is_err(), "it is about callers");
        let config = serve(&[&open[..], &["--web-insecure"]].concat());
        assert_eq!(config.validate(), Ok(()));
        assert!(!config.insecure && config.access.tokens_required(false, config.insecure));
        assert_eq!(serve(&[&open[..], &["--tls-cert", "c", "--tls-key", "k"]].concat()).validate(), Ok(()));
    }

    #[test]
    fn policies_are_served_within_reason() {
        for (flag, value) in [
            ("--policy-batch", "0"),
            ("--policy-batch-wait", "0.6"),
            ("--policy-batch-wait", "NaN"),
            ("--policy-spin-us", "100001"),
            ("--session-idle-seconds", "0"),
            ("--drain-seconds", "3601"),
        ] {
            let problem = serve(&[flag, value]).validate().unwrap_err();
            assert!(problem.contains(flag), "{problem}");
        }
    }

    #[test]
    fn a_secret_does_not_show() {
        assert_eq!(format!("{:?}", Secret::from("token".to_owned())), "(secret)");
    }
}
