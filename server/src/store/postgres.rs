//! The address of a database in PostgreSQL, and whether it can be used.

mod changes;
mod connections;
mod leader;
mod pool;

use std::{fmt, fs, net::SocketAddr, process::Stdio, str::FromStr as _, time::Duration};

use gleaner_core::Secret;
use sqlx::{Connection as _, PgConnection, postgres::PgConnectOptions};
use tokio::process::Command;

pub(super) use self::leader::leader;
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
    /// The address as it was given.
    url: Secret,
    /// The password, if one was given by the address or by a file.
    password: Option<Secret>,
    /// The address of the server that uses the database, for its standbys.
    listen: Option<SocketAddr>,
}

impl Postgres {
    /// The configured database, if one is configured.
    ///
    /// # Errors
    /// Invalid names the flag.
    pub(crate) fn configured(config: &DatabaseConfig) -> Result<Option<Self>> {
        let Some(url) = &config.database else { return Ok(None) };
        let mut at = Self::at(url.reveal())?;
        at.timeout = Duration::from_secs(config.database_timeout_seconds);
        if let Some(file) = &config.database_password_file {
            let password = fs::read_to_string(file).map_err(|error| {
                let file = file.display();
                Error::invalid("--database-password-file", format!("{file} cannot be read: {error}"))
            })?;
            let password = password.trim_end_matches(['\r', '\n']);
            at.options = at.options.password(password);
            at.password = Some(Secret::from(password.to_owned()));
        }
        Ok(Some(at))
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
        Ok(Self {
            options: options.statement_cache_capacity(PREPARED),
            timeout,
            url: Secret::from(url.to_owned()),
            password: parts(url).1.map(decoded),
            listen: None,
        })
    }

    /// The same for the server that listens on this address.
    pub(crate) fn of_server(&self, listen: SocketAddr) -> Self {
        Self { listen: Some(listen), ..self.clone() }
    }

    /// Whether a server leads the database.
    ///
    /// # Errors
    /// Precondition when PostgreSQL cannot be reached.
    pub(crate) async fn has_leader(&self) -> Result<bool> {
        let mut connection = self.look().await?;
        let led = leader::is_led(&mut connection).await.map_err(|error| connecting(self, error))?;
        connection.close().await.map_err(|error| connecting(self, error))?;
        Ok(led)
    }

    /// The same with a name for its connections that no other server has, and that has the address of this one. Names
    /// have up to 63 bytes in PostgreSQL.
    fn of_one_server(&self) -> Self {
        let listen = self.listen.map(|listen| format!(" {listen}")).unwrap_or_default();
        let name = format!("gleaner {:06x}{listen}", rand::random::<u32>() & 0xff_ffff);
        Self { options: self.options.clone().application_name(&name), ..self.clone() }
    }

    /// The address without a password, for the arguments of PostgreSQL's own programs.
    pub(super) fn shown_url(&self) -> String {
        parts(self.url.reveal()).0
    }

    /// A program of PostgreSQL. The password is in its environment, because arguments are visible to every user.
    pub(super) fn program(&self, name: &str) -> Command {
        let mut command = Command::new(name);
        if let Some(password) = &self.password {
            command.env("PGPASSWORD", password.reveal());
        }
        command.stdin(Stdio::null()).kill_on_drop(true);
        command
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

/// An address without its password, and the password as it is encoded there.
fn parts(url: &str) -> (String, Option<&str>) {
    let whole = || (url.to_owned(), None);
    let Some((scheme, rest)) = url.split_once("://") else { return whole() };
    let end = rest.find(['/', '?']).unwrap_or(rest.len());
    let (authority, path) = rest.split_at(end);
    let Some((user, host)) = authority.rsplit_once('@') else { return whole() };
    match user.split_once(':') {
        Some((user, password)) => (format!("{scheme}://{user}@{host}{path}"), Some(password)),
        None => whole(),
    }
}

/// A text whose special characters are written as `%41`.
fn decoded(encoded: &str) -> Secret {
    let mut bytes = Vec::new();
    let mut rest = encoded.as_bytes();
    while let Some((&first, after)) = rest.split_first() {
        let byte = after.get(..2).filter(|_| first == b'%').and_then(|digits| std::str::from_utf8(digits).ok());
        match byte.and_then(|digits| u8::from_str_radix(digits, 16).ok()) {
            Some(byte) => {
                bytes.push(byte);
                rest = after.get(2..).unwrap_or_default();
            }
            None => {
                bytes.push(first);
                rest = after;
            }
        }
    }
    Secret::from(String::from_utf8_lossy(&bytes).into_owned())
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
