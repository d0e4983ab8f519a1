//! The address of a database in PostgreSQL, and whether it can be used.

mod connections;
mod leader;
mod pool;

use std::{fmt, fs, str::FromStr as _, time::Duration};

use sqlx::{Connection as _, PgConnection, postgres::PgConnectOptions};

use super::{fault::connecting, sql::within};
use crate::{
    config::DatabaseConfig,
    error::{Error, Result},
};

/// The oldest version of PostgreSQL that the tests run on.
const OLDEST: i32 = 150_000;
/// Settings of every session. A server whose machine or network is lost must not keep its lock for hours. A rollback
/// without a transaction sends no notice.
const SESSION: [(&str, &str); 5] = [
    ("tcp_user_timeout", "30000"),
    ("tcp_keepalives_idle", "15"),
    ("tcp_keepalives_interval", "5"),
    ("tcp_keepalives_count", "3"),
    ("client_min_messages", "error"),
];
/// The parameters of an address that are understood. sqlx would write others to the log, with their values.
const PARAMETERS: [&str; 6] = ["host", "port", "sslmode", "sslrootcert", "sslcert", "sslkey"];

/// Statements that a connection keeps prepared: every one of the store.
const PREPARED: usize = 400;

/// The address of a PostgreSQL database. It is shown without the password.
#[derive(Clone)]
pub(crate) struct Postgres {
    options: PgConnectOptions,
    /// The longest wait for a connection, and the longest silence on one.
    timeout: Duration,
}

impl Postgres {
    /// The configured database, if one is configured.
    ///
    /// # Errors
    /// Invalid names the flag.
    pub(crate) fn configured(config: &DatabaseConfig) -> Result<Option<Self>> {
        let Some(url) = &config.database else { return Ok(None) };
        let Self { options, .. } = Self::at(url.reveal())?;
        let options = match &config.database_password_file {
            None => options,
            Some(file) => {
                let password = fs::read_to_string(file).map_err(|error| {
                    let file = file.display();
                    Error::invalid("--database-password-file", format!("{file} cannot be read: {error}"))
                })?;
                options.password(password.trim_end_matches(['\r', '\n']))
            }
        };
        Ok(Some(Self { options, timeout: Duration::from_secs(config.database_timeout_seconds) }))
    }

    /// The database at an address: postgres://USER@HOST:PORT/NAME.
    ///
    /// # Errors
    /// Invalid.
    pub(crate) fn at(url: &str) -> Result<Self> {
        // A secret with a `?` in it would be read as parameters, and be named below.
        if url.split_once('?').is_some_and(|(_, rest)| rest.contains('@')) {
            let fix = "write `?`, `&` and `@` of a user or password as %3F, %26 and %40";
            return Err(Error::invalid("--database", format!("an @ follows a ?; {fix}")));
        }
        let parameters = url.split_once('?').map_or("", |(_, parameters)| parameters).split('&');
        let mut names = parameters.filter_map(|one| one.split('=').next()).filter(|name| !name.is_empty());
        if let Some(unknown) = names.find(|name| !PARAMETERS.contains(name)) {
            let known = PARAMETERS.join(", ");
            return Err(Error::invalid("--database", format!("the address has a parameter {unknown}; use {known}")));
        }
        let options = PgConnectOptions::from_str(url)
            .map_err(|error| Error::invalid("--database", format!("not an address of PostgreSQL: {error}")))?;
        let options = options.application_name("gleaner-server").options(SESSION);
        let timeout = Duration::from_secs(DatabaseConfig::default().database_timeout_seconds);
        Ok(Self { options: options.statement_cache_capacity(PREPARED), timeout })
    }

    /// The same with a name for its connections that no other server has.
    fn of_one_server(&self) -> Self {
        let name = format!("gleaner-server {:08x}", rand::random::<u32>());
        Self { options: self.options.clone().application_name(&name), timeout: self.timeout }
    }

    /// A connection for a look before the database is opened.
    async fn look(&self) -> Result<PgConnection> {
        let connected = within(self.timeout, PgConnection::connect_with(&self.options)).await;
        connected.map_err(|error| connecting(self, error))
    }

    /// Rejects a server that is too old, a database of other programs, and one that another server uses.
    pub(super) async fn expect_usable(&self, serving: bool) -> Result<()> {
        let mut connection = self.look().await?;
        let doing = |error| connecting(self, error);
        let (version, encoding): (i32, String) =
            sqlx::query_as("select current_setting('server_version_num')::int4, current_setting('server_encoding')")
                .fetch_one(&mut connection)
                .await
                .map_err(doing)?;
        if version < OLDEST {
            let (found, oldest) = (version / 10_000, OLDEST / 10_000);
            return Err(Error::precondition(format!("{self}: PostgreSQL {found} is too old; use {oldest} or newer")));
        }
        if encoding != "UTF8" {
            return Err(Error::precondition(format!(
                "{self}: the database is encoded in {encoding}; create one with `createdb --encoding=UTF8 --template=template0`"
            )));
        }
        let foreign: bool = sqlx::query_scalar(
            "select to_regclass('_sqlx_migrations') is null and exists \
             (select 1 from pg_catalog.pg_tables where schemaname = current_schema())",
        )
        .fetch_one(&mut connection)
        .await
        .map_err(doing)?;
        if foreign {
            return Err(Error::precondition(format!(
                "{self}: the database has tables of another program; create an empty database for gleaner with `createdb`"
            )));
        }
        if serving {
            leader::expect_none(self, &mut connection).await?;
        }
        connection.close().await.map_err(doing)
    }
}

impl fmt::Display for Postgres {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let options = &self.options;
        let host = match options.get_socket() {
            Some(socket) => socket.display().to_string(),
            None => format!("{}:{}", options.get_host(), options.get_port()),
        };
        let database = options.get_database().unwrap_or_else(|| options.get_username());
        write!(f, "postgres://{}@{host}/{database}", options.get_username())
    }
}

impl fmt::Debug for Postgres {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Postgres({self})")
    }
}

#[cfg(test)]
mod tests;
