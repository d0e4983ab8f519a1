//! Configuration: flags and `GLEANER_…` variables, read once. The only module that reads the environment.

mod access;
mod blob_store;
mod children;
mod connections;
mod database;
mod engine;
mod jobs;
mod limits;
mod maintenance;
mod openpi;
mod plan;
mod policies;
mod policy_servers;
mod ranks;
mod telemetry;
mod tls;
mod uploads;

use std::{net::SocketAddr, path::PathBuf};

use clap::{Args, Parser, Subcommand};
use gleaner_logs::LogOptions;

pub use gleaner_core::Secret;

pub use self::{
    access::{AccessConfig, AuditConfig, NewTokenConfig, TokenCommand, TokenConfig},
    blob_store::BlobStoreConfig,
    children::{cluster_environment, worker_environment},
    connections::ConnectionsConfig,
    database::DatabaseConfig,
    engine::{EngineConfig, EngineKind},
    jobs::JobsConfig,
    limits::LimitConfig,
    maintenance::{
        BackupConfig, CheckConfig, MaintenanceCommand, MaintenanceConfig, MigrateConfig, RebuildConfig, RestoreConfig,
    },
    openpi::OpenpiConfig,
    plan::PlanConfig,
    policies::PoliciesConfig,
    policy_servers::PolicyServersConfig,
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
    /// Serve reads and sessions beside the server that leads the same --database and data folder, reject changes with its
    /// address, and take the lead once it is gone. The first server that is started leads. The data folder must be on a
    /// file system that keeps locks for all its machines.
    #[arg(long, env = "GLEANER_STANDBY")]
    pub standby: bool,
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
    /// Policies of other servers.
    #[command(flatten)]
    pub policy_servers: PolicyServersConfig,
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
        if self.standby && self.database.database.is_none() {
            return Err("--standby: needs --database, because servers share a database in PostgreSQL".to_owned());
        }
        if self.standby && self.maintenance.accept_database {
            return Err("--accept-database: start one server with it and without --standby first".to_owned());
        }
        self.limits.validate()?;
        if self.drain_seconds > 3600 {
            return Err("--drain-seconds: must be at most 3600".to_owned());
        }
        self.connections.validate()?;
        self.telemetry.validate(self.access.tls_cert.is_some())?;
        self.openpi.validate(self.access.tls_cert.is_some(), self.insecure)?;
        self.blob_store.validate()?;
        self.maintenance.validate()?;
        self.jobs.validate(self.access.tls_cert.is_some(), self.insecure)?;
        self.policies.validate()?;
        self.policy_servers.validate()
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
    fn standby_needs_a_database_that_servers_share() {
        let url = ["--standby", "--database", "postgres://gleaner@db/lab"];
        assert!(serve(&["--standby"]).validate().unwrap_err().contains("--database"));
        assert_eq!(serve(&url).validate(), Ok(()));
        assert!(serve(&[&url[..], &["--accept-database"]].concat()).validate().unwrap_err().contains("--standby"));
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
