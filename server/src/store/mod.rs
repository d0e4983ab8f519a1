//! The database: the only module with SQL. One file per family of tables.
//!
//! One connection writes, several read. Every write commits with `synchronous=FULL`: it is on disk when the call
//! returns. Arguments and results are domain values.

pub(crate) mod attempt;
mod audit;
pub(crate) mod backlog;
mod blob;
mod check;
mod clock;
mod copy;
mod curation;
mod dataset;
mod deployment;
mod encoder;
mod episode;
mod evaluation;
mod export;
mod fault;
pub(crate) mod finish;
mod job;
mod kept;
mod lab;
mod metric;
mod missing_result;
mod open_shared;
mod packed;
mod policy;
pub(crate) mod queue;
mod read_only;
mod row;
mod schedule;
mod score;
mod sidecar;
mod snapshot;
mod task;
#[cfg(test)]
pub(crate) mod testing;
mod token;
mod trash;
mod upload;

use std::{
    path::Path,
    sync::{Arc, OnceLock},
    time::Duration,
};

use sqlx::{
    Connection as _, Sqlite, SqlitePool, Transaction,
    sqlite::{SqliteConnectOptions, SqliteJournalMode, SqlitePoolOptions, SqliteSynchronous},
};

use self::fault::fault;
pub(crate) use self::{blob::NamedBlob, read_only::ReadOnlyDatabase, sidecar::Described};
use crate::error::{Error, Result};

static MIGRATIONS: sqlx::migrate::Migrator = sqlx::migrate!("../migrations");

/// SQLite before this can lose acknowledged commits when a commit races a checkpoint.
const OLDEST_SQLITE: (u32, u32, u32) = (3, 51, 3);

/// Connections that read; one more writes.
const READERS: u32 = 4;

/// Handle to the database; clones share it.
#[derive(Debug, Clone)]
pub struct Store {
    writer: SqlitePool,
    readers: SqlitePool,
    /// The link of a server's database to its folder; empty for a database that is only read.
    tie: Arc<OnceLock<lab::Tie>>,
}

impl Store {
    /// Opens the database at `path`, creates it if missing and brings its schema up to date.
    ///
    /// # Errors
    /// Precondition when the linked SQLite is too old or the database is newer than this program.
    pub async fn open(path: &Path) -> Result<Self> {
        let options = SqliteConnectOptions::new()
            .filename(path)
            .create_if_missing(true)
            .foreign_keys(true)
            .journal_mode(SqliteJournalMode::Wal)
            .synchronous(SqliteSynchronous::Full)
            .busy_timeout(Duration::from_secs(10));
        let doing = |error: sqlx::Error| Error::internal(format!("opening the database {}", path.display()), error);
        let writer = lasting(1).after_release(|connection, _| {
            Box::pin(async move {
                // Dropped transactions are rolled back by now. On a full disk SQLite rolls back automatically and the
                // connection does not notice, so that it would reject every transaction. A new connection then takes
                // its place.
                connection.ping().await?;
                Ok(!connection.is_in_transaction())
            })
        });
        let writer = writer.connect_with(options.clone()).await.map_err(doing)?;
        // A later connection must not create a database in place of one that was deleted.
        let options = options.create_if_missing(false);
        writer.set_connect_options(options.clone());
        check_version(&writer).await?;
        let (found, newest) = (read_only::known_schema(&writer, path).await?, read_only::newest_schema());
        if found > 0 && found < newest {
            tracing::info!(schema.found = found, schema.newest = newest, "updating the database");
        }
        MIGRATIONS.run(&writer).await.map_err(|error| {
            if let sqlx::migrate::MigrateError::VersionMissing(version) = error {
                return Error::precondition(format!(
                    "the database {} has a migration {version} that this program does not know: use the gleaner-server \
                     that made it",
                    path.display()
                ));
            }
            Error::internal("migrating the database", error)
        })?;
        // All connections from the beginning: one that is opened under load is late, and its memory is needed when
        // least is free.
        let readers = lasting(READERS).min_connections(READERS).connect_with(options).await.map_err(doing)?;
        Ok(Self { writer, readers, tie: Arc::default() })
    }

    /// Closes every connection; the last one checkpoints the log.
    pub async fn close(&self) {
        self.readers.close().await;
        self.writer.close().await;
    }

    /// Begins a write. IMMEDIATE: a transaction that becomes a write later would fail at once.
    async fn write(&self) -> Result<Transaction<'static, Sqlite>> {
        self.writer.begin_with("begin immediate").await.map_err(fault("beginning a write"))
    }

    /// Commits a write: it is on disk, in the database at the path, when this returns.
    ///
    /// # Errors
    /// Precondition when the database was deleted or replaced; the errors of the disk.
    async fn commit(&self, transaction: Transaction<'static, Sqlite>) -> Result<()> {
        transaction.commit().await.map_err(fault("committing a write"))?;
        self.verify()
    }

    /// The pool to read from.
    fn read(&self) -> &SqlitePool {
        &self.readers
    }
}

/// A pool whose connections stay open, because a new one would open whatever file is then at the path.
fn lasting(connections: u32) -> SqlitePoolOptions {
    SqlitePoolOptions::new().max_connections(connections).idle_timeout(None).max_lifetime(None)
}

/// Whether the error is a violated `unique` or primary key.
fn is_duplicate(error: &sqlx::Error) -> bool {
    error.as_database_error().is_some_and(sqlx::error::DatabaseError::is_unique_violation)
}

async fn check_version(pool: &SqlitePool) -> Result<()> {
    let version: String = sqlx::query_scalar("select sqlite_version()")
        .fetch_one(pool)
        .await
        .map_err(fault("reading SQLite's version"))?;
    let mut parts = version.split('.').map(|part| part.parse::<u32>().unwrap_or(0));
    let mut next = || parts.next().unwrap_or(0);
    if (next(), next(), next()) < OLDEST_SQLITE {
        return Err(Error::precondition(format!(
            "SQLite {version} can lose acknowledged writes; build with libsqlite3-sys 0.37 or newer (SQLite 3.51.3)"
        )));
    }
    Ok(())
}

#[cfg(test)]
mod tests;
