//! Opening a database read-only, beside a running server or in a backup; its schema version and its integrity.

use std::{path::Path, time::Duration};

use sqlx::{
    SqlitePool,
    sqlite::{SqliteConnectOptions, SqlitePoolOptions},
};
use tempfile::TempDir;

use super::{MIGRATIONS, Store, check_version, fault};
use crate::error::{Error, Kind, Result};

/// A database that is only read.
#[derive(Debug)]
pub(crate) struct ReadOnlyDatabase {
    /// For reading; every write is rejected.
    pub(crate) store: Store,
    /// The newest migration in the database.
    pub(crate) schema: i64,
    /// The folder of a migrated copy of an older database.
    _copy: Option<TempDir>,
}

/// The newest migration of this program.
pub(crate) fn newest_schema() -> i64 {
    MIGRATIONS.iter().map(|migration| migration.version).max().unwrap_or_default()
}

/// Rejects a database migrated by a newer program; returns its newest migration, 0 for none.
pub(super) async fn known_schema(pool: &SqlitePool, path: &Path) -> Result<i64> {
    let there: bool = sqlx::query_scalar("select exists (select 1 from sqlite_master where name = '_sqlx_migrations')")
        .fetch_one(pool)
        .await
        .map_err(fault("reading the database's schema"))?;
    if !there {
        return Ok(0);
    }
    let found: Option<i64> = sqlx::query_scalar("select max(version) from _sqlx_migrations")
        .fetch_one(pool)
        .await
        .map_err(fault("reading the database's version"))?;
    let (found, newest) = (found.unwrap_or_default(), newest_schema());
    if found > newest {
        return Err(Error::precondition(format!(
            "the database {} has schema version {found}, and gleaner-server {} supports versions up to {newest}: use \
             the newer gleaner-server that made it, or restore an earlier backup",
            path.display(),
            env!("CARGO_PKG_VERSION"),
        )));
    }
    Ok(found)
}

impl ReadOnlyDatabase {
    /// Opens the database at `path`. An older schema is copied and migrated in the copy.
    ///
    /// # Errors
    /// Precondition when it is missing, is not a gleaner database, or is newer than this program.
    pub(crate) async fn open(path: &Path) -> Result<Self> {
        if !path.is_file() {
            return Err(Error::precondition(format!(
                "there is no database {}; --data-dir names a server's data folder, or a backup",
                path.display()
            )));
        }
        let opened = async {
            let store = open_read_only(path).await?;
            let schema = known_schema(&store.readers, path).await?;
            Ok((store, schema))
        };
        let (store, schema) = opened.await.map_err(|error: Error| {
            if error.kind() != Kind::Internal {
                return error;
            }
            Error::precondition(format!(
                "the database {} is damaged: {error}. Restore a backup, or make the database again with `gleaner-server \
                 rebuild`",
                path.display()
            ))
        })?;
        if schema == 0 {
            return Err(Error::precondition(format!("{} is not a gleaner database", path.display())));
        }
        if schema == newest_schema() {
            return Ok(Self { store, schema, _copy: None });
        }
        let folder = tempfile::tempdir().map_err(|error| Error::internal("making a folder for a copy", error))?;
        let copy = folder.path().join("gleaner.db");
        store.copy_to(&copy).await?;
        store.close().await;
        // Opening migrates it.
        Store::open(&copy).await?.close().await;
        Ok(Self { store: open_read_only(&copy).await?, schema, _copy: Some(folder) })
    }
}

impl Store {
    /// SQLite's own integrity findings, and dangling rows.
    pub(crate) async fn integrity(&self) -> Result<Vec<(String, String)>> {
        let fault = || fault("checking the database");
        let lines: Vec<String> =
            sqlx::query_scalar("pragma integrity_check").fetch_all(self.read()).await.map_err(fault())?;
        let damage = lines.into_iter().filter(|line| line != "ok").map(|line| ("database".to_owned(), line));
        let dangling: Vec<(String, Option<i64>, String)> =
            sqlx::query_as("select \"table\", rowid, parent from pragma_foreign_key_check")
                .fetch_all(self.read())
                .await
                .map_err(fault())?;
        let dangling = dangling.into_iter().map(|(table, row, parent)| {
            let row = row.map_or_else(String::new, |row| format!(" {row}"));
            (format!("{table} row{row}"), format!("names a row of {parent} that does not exist"))
        });
        Ok(damage.chain(dangling).collect())
    }
}

/// Opens a database read-only; no file is changed, not even on close.
pub(super) async fn open_read_only(path: &Path) -> Result<Store> {
    let options = SqliteConnectOptions::new().filename(path).read_only(true).busy_timeout(Duration::from_secs(10));
    let pool = SqlitePoolOptions::new().max_connections(1).connect_with(options).await.map_err(|error| {
        Error::precondition(format!("cannot open the database {} to read: {error}", path.display()))
    })?;
    check_version(&pool).await?;
    Ok(Store { writer: pool.clone(), readers: pool, tie: std::sync::Arc::default() })
}
