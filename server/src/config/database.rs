//! Where the database is.

use std::path::PathBuf;

use clap::Args;
use gleaner_core::Secret;

/// The database.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Database")]
pub struct DatabaseConfig {
    /// PostgreSQL database to use in place of the SQLite file in the data folder: postgres://USER@HOST:PORT/NAME, or
    /// with `?host=/FOLDER` for a socket, and with `sslmode`, `sslrootcert`, `sslcert` and `sslkey` for TLS. PostgreSQL brings others' backups and costs a round trip for each statement.
    /// One server at a time leads (see --standby), and the database must belong to the blobs in the data folder. A password in the address
    /// is visible in the list of processes; use the next flag, or the variables PGPASSWORD or PGPASSFILE. Default:
    /// SQLite.
    #[arg(long, env = "GLEANER_DATABASE", value_name = "URL", hide_env_values = true, global = true)]
    pub database: Option<Secret>,
    /// File whose content is the password of the database in PostgreSQL. It replaces a password in the address.
    #[arg(long, env = "GLEANER_DATABASE_PASSWORD_FILE", value_name = "FILE", global = true)]
    pub database_password_file: Option<PathBuf>,
    /// Fail a call with UNAVAILABLE when PostgreSQL sends nothing for this many seconds, 2 to 3600, as after a cut cable;
    /// its connection is then replaced. A statement that takes longer fails too.
    #[arg(
        long,
        env = "GLEANER_DATABASE_TIMEOUT_SECONDS",
        default_value_t = TIMEOUT,
        value_name = "SECONDS",
        value_parser = clap::value_parser!(u64).range(2..=3600),
        global = true
    )]
    pub database_timeout_seconds: u64,
}

/// The default of `--database-timeout-seconds`.
const TIMEOUT: u64 = 10;

impl Default for DatabaseConfig {
    fn default() -> Self {
        Self { database: None, database_password_file: None, database_timeout_seconds: TIMEOUT }
    }
}

impl DatabaseConfig {
    /// Checks the kind of the address.
    ///
    /// # Errors
    /// A sentence that names the flag, without the address, which may have a password.
    pub(super) fn validate(&self) -> Result<(), String> {
        let known =
            |url: &Secret| ["postgres://", "postgresql://"].iter().any(|scheme| url.reveal().starts_with(scheme));
        match &self.database {
            Some(url) if !known(url) => {
                Err("--database: must begin with postgres://; leave the flag out for SQLite in the data folder"
                    .to_owned())
            }
            Some(_) | None => Ok(()),
        }
    }
}
