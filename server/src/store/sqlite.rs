//! Opening SQLite: one connection that writes, several that read.

use std::{path::Path, time::Duration};

use sqlx::{
    Connection as _, SqlitePool,
    sqlite::{SqliteConnectOptions, SqliteJournalMode, SqlitePoolOptions, SqliteSynchronous},
};

use super::{Store, fault, schema, sql::Pool};
use crate::error::{Error, Result};

/// SQLite before this can lose acknowledged commits when a commit races a checkpoint.
const OLDEST_SQLITE: (u32, u32, u32) = (3, 51, 3);

/// Connections that read; one more writes.
const READERS: u32 = 4;

impl Store {
    /// Opens the SQLite database at `path`, creates it if missing and brings its schema up to date. Every write commits
    /// with `synchronous=FULL`.
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
        schema::update(&Pool::Sqlite(writer.clone()), path.display()).await?;
        // All connections from the beginning: one that is opened under load is late, and its memory is needed when
        // least is free.
        let readers = lasting(READERS).min_connections(READERS).connect_with(options).await.map_err(doing)?;
        Ok(Self::untied(Pool::Sqlite(writer), Pool::Sqlite(readers)))
    }
}

/// A pool whose connections stay open, because a new one would open whatever file is then at the path.
fn lasting(connections: u32) -> SqlitePoolOptions {
    SqlitePoolOptions::new().max_connections(connections).idle_timeout(None).max_lifetime(None)
}

/// Rejects a SQLite that can lose acknowledged writes.
pub(super) async fn check_version(pool: &SqlitePool) -> Result<()> {
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
