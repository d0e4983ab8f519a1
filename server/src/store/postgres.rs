//! Opening PostgreSQL: for the one server that uses a database, and for commands beside it.
//!
//! The connection that writes holds a lock of the whole session, so that every write of a server is made while no other
//! server has the database: a server whose connection was lost writes again only after it has the lock again.

use std::{
    fmt, fs,
    str::FromStr as _,
    sync::{Arc, OnceLock},
    time::Duration,
};

use sqlx::{
    Connection as _, Executor as _, PgConnection,
    postgres::{PgConnectOptions, PgPoolOptions},
};

use super::{Store, fault::connecting, schema, sql::Pool, tie::Tie};
use crate::{
    config::DatabaseConfig,
    error::{Error, Result},
};

/// The oldest version of PostgreSQL that the tests run on.
const OLDEST: i32 = 150_000;
/// Connections that read; one more writes.
const READERS: u32 = 8;
/// Longest wait for a connection, and for other writers.
const PATIENCE: Duration = Duration::from_secs(10);
/// Settings of every session. A server whose machine or network is lost must not keep its lock for hours. A rollback
/// without a transaction sends no notice.
const SESSION: [(&str, &str); 5] = [
    ("lock_timeout", "10s"),
    ("tcp_keepalives_idle", "15"),
    ("tcp_keepalives_interval", "5"),
    ("tcp_keepalives_count", "3"),
    ("client_min_messages", "error"),
];
/// The parameters of an address that are understood. sqlx would write others to the log, with their values.
const PARAMETERS: [&str; 6] = ["host", "port", "sslmode", "sslrootcert", "sslcert", "sslkey"];

/// Statements that a connection keeps prepared: every one of the store.
const PREPARED: usize = 400;

/// The key of the lock that the one server of a database holds.
const SERVER_LOCK: i64 = 7_236_279_350_437_208_691;

/// The address of a PostgreSQL database. It is shown without the password.
#[derive(Clone)]
pub(crate) struct Postgres {
    options: PgConnectOptions,
}

impl Postgres {
    /// The configured database, if one is configured.
    ///
    /// # Errors
    /// Invalid names the flag.
    pub(crate) fn configured(config: &DatabaseConfig) -> Result<Option<Self>> {
        let Some(url) = &config.database else { return Ok(None) };
        let Self { options } = Self::at(url.reveal())?;
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
        Ok(Some(Self { options }))
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
        Ok(Self { options: options.statement_cache_capacity(PREPARED) })
    }

    /// A connection for a look before the database is opened.
    async fn look(&self) -> Result<PgConnection> {
        let connected = tokio::time::timeout(PATIENCE, PgConnection::connect_with(&self.options)).await;
        connected.unwrap_or(Err(sqlx::Error::PoolTimedOut)).map_err(|error| connecting(self, error))
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
            self.expect_no_server(&mut connection).await?;
        }
        connection.close().await.map_err(doing)
    }

    /// Rejects a database that a server uses.
    async fn expect_no_server(&self, connection: &mut PgConnection) -> Result<()> {
        let free: bool = sqlx::query_scalar("select pg_try_advisory_lock($1)")
            .bind(SERVER_LOCK)
            .fetch_one(&mut *connection)
            .await
            .map_err(|error| connecting(self, error))?;
        if free {
            return Ok(());
        }
        // The key of a lock is stored in two halves.
        let place: Option<String> = sqlx::query_scalar(
            "select coalesce(host(client_addr), 'the machine of the database') from pg_catalog.pg_locks \
             join pg_catalog.pg_stat_activity using (pid) \
             where locktype = 'advisory' and granted and (classid::bigint << 32) | objid::bigint = $1 limit 1",
        )
        .bind(SERVER_LOCK)
        .fetch_optional(connection)
        .await
        .map_err(|error| connecting(self, error))?;
        let place = place.map(|place| format!(", connected from {place}")).unwrap_or_default();
        Err(Error::precondition(format!(
            "{self}: another gleaner-server uses this database{place}. A database has one server: stop the other one, or \
             name another database with --database"
        )))
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

impl Store {
    /// Opens a database for the one server that uses it, and brings its schema up to date.
    ///
    /// # Errors
    /// Precondition when PostgreSQL cannot be reached or is too old, when it rejects the user, when another server uses
    /// the database, or when that is newer than this program.
    pub(crate) async fn serve_postgres(at: &Postgres) -> Result<Self> {
        at.expect_usable(true).await?;
        let doing = |error| connecting(at, error);
        let tie = Arc::<OnceLock<Tie>>::default();
        // The connection that writes stays open, because it holds the lock of this server.
        let writer = patient(1).idle_timeout(None).max_lifetime(None);
        let writer = writer.after_connect({
            let tie = Arc::clone(&tie);
            move |connection, _| Box::pin(take_over(connection, Arc::clone(&tie)))
        });
        let writer = writer.connect_with(at.options.clone()).await.map_err(doing)?;
        let fsync: String = sqlx::query_scalar("show fsync").fetch_one(&writer).await.map_err(doing)?;
        if fsync == "off" {
            tracing::warn!(database = %at, "fsync is off in PostgreSQL: a power cut can lose acknowledged data");
        }
        schema::update(&Pool::Postgres(writer.clone()), at).await?;
        let readers = patient(READERS).connect_with(at.options.clone()).await.map_err(doing)?;
        Ok(Self { writer: Pool::Postgres(writer), readers: Pool::Postgres(readers), tie })
    }

    /// Opens a database to read it, of any schema or none.
    ///
    /// # Errors
    /// Precondition when it cannot be used.
    pub(crate) async fn look_at(at: &Postgres) -> Result<Self> {
        at.expect_usable(false).await?;
        let options = at.options.clone().options([("default_transaction_read_only", "on")]);
        let pool = patient(1).connect_with(options).await.map_err(|error| connecting(at, error))?;
        Ok(Self::untied(Pool::Postgres(pool.clone()), Pool::Postgres(pool)))
    }

    /// Opens a database that a server may use, for a few writes of a command.
    ///
    /// # Errors
    /// Precondition when it cannot be used, is empty, or has another schema than this program.
    pub(crate) async fn open_beside(at: &Postgres) -> Result<Self> {
        at.expect_usable(false).await?;
        let pool = patient(1).after_connect(|connection, _| Box::pin(durable(connection)));
        let pool = Pool::Postgres(pool.connect_with(at.options.clone()).await.map_err(|error| connecting(at, error))?);
        match schema::known(&pool, at).await? {
            found if found == schema::newest() => Ok(Self::untied(pool.clone(), pool)),
            0 => Err(Error::precondition(format!("{at}: the database is empty; start a server with it first"))),
            found => Err(Error::precondition(format!(
                "{at}: the database has schema version {found}, and this program {}; start its server once, or use the \
                 gleaner-server of that version",
                schema::newest()
            ))),
        }
    }
}

/// Makes a connection the one that writes: with the lock of the one server, to a database that has everything that was
/// acknowledged. The database may be a replica that took over and had not received all of it.
async fn take_over(connection: &mut PgConnection, tie: Arc<OnceLock<Tie>>) -> sqlx::Result<()> {
    durable(connection).await?;
    let lock = sqlx::query_scalar("select pg_try_advisory_lock($1)").bind(SERVER_LOCK);
    if !lock.fetch_one(&mut *connection).await? {
        return Err(sqlx::Error::Configuration("another server has the database".into()));
    }
    let Some(tie) = tie.get() else { return Ok(()) };
    let (folder, generation): (String, i64) =
        sqlx::query_as("select folder, generation from lab").fetch_one(connection).await?;
    match tie.is_still(&folder, u64::try_from(generation).unwrap_or(0)) {
        true => Ok(()),
        false => Err(sqlx::Error::Configuration("the database is not the one that the server used".into())),
    }
}

fn patient(connections: u32) -> PgPoolOptions {
    let options = PgPoolOptions::new().max_connections(connections).acquire_timeout(PATIENCE);
    // A transaction whose beginning was interrupted, by a caller that is gone or a lock that was not had, is open in
    // PostgreSQL and unknown to sqlx.
    options.after_release(|connection, _| Box::pin(async move { connection.execute("rollback").await.map(|_| true) }))
}

/// Has a commit return once it is on disk, also where the database is set up to return earlier. A stricter setting, of a
/// database with replicas, stays.
async fn durable(connection: &mut PgConnection) -> sqlx::Result<()> {
    let on = "select set_config('synchronous_commit', 'on', false) where current_setting('synchronous_commit') = 'off'";
    sqlx::query(on).execute(connection).await?;
    Ok(())
}

#[cfg(test)]
mod tests;
