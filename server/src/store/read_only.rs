//! Opening a database read-only, beside a running server or in a backup; its schema version and its integrity.

use std::{path::Path, time::Duration};

use sqlx::sqlite::{SqliteConnectOptions, SqlitePoolOptions};
use tempfile::TempDir;

use super::{Database, Store, fault, row, schema, sql::Pool, sqlite::check_version};
use crate::{
    data_folder,
    error::{Error, Kind, Result},
};

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

impl ReadOnlyDatabase {
    /// Opens the configured database of a data folder.
    ///
    /// # Errors
    /// As for [`ReadOnlyDatabase::open`]; Precondition when a database in PostgreSQL has an older schema.
    pub(crate) async fn configured(database: &Database) -> Result<Self> {
        let Some(at) = &database.postgres else { return Self::open(&data_folder::database(&database.data_dir)).await };
        let store = Store::look_at(at).await?;
        match schema::known(&store.readers, at).await? {
            0 => Err(Error::precondition(format!("{at} is not a gleaner database"))),
            found if found == schema::newest() => Ok(Self { store, schema: found, _copy: None }),
            found => Err(Error::precondition(format!(
                "{at} has schema version {found}, and this program {}; start its server once",
                schema::newest()
            ))),
        }
    }

    /// Rejects the database of a newer program at `path`, also a damaged one. One without a version that can be read
    /// passes.
    ///
    /// # Errors
    /// Precondition names both versions.
    pub(crate) async fn expect_known(path: &Path) -> Result<()> {
        let Ok(store) = open_read_only(path).await else { return Ok(()) };
        let found = schema::version(&store.readers).await;
        store.close().await;
        found.map_or(Ok(()), |found| schema::expect_known(found, path.display()))
    }

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
            let found = schema::known(&store.readers, path.display()).await?;
            Ok((store, found))
        };
        let (store, found) = opened.await.map_err(|error: Error| {
            if error.kind() != Kind::Internal {
                return error;
            }
            Error::precondition(format!(
                "the database {} is damaged: {error}. Restore a backup, or make the database again with `gleaner-server \
                 rebuild`",
                path.display()
            ))
        })?;
        if found == 0 {
            return Err(Error::precondition(format!("{} is not a gleaner database", path.display())));
        }
        if found == schema::newest() {
            return Ok(Self { store, schema: found, _copy: None });
        }
        let folder = tempfile::tempdir().map_err(|error| Error::internal("making a folder for a copy", error))?;
        let copy = folder.path().join("gleaner.db");
        store.copy_to(&copy).await?;
        store.close().await;
        // Opening migrates it.
        Store::open(&copy).await?.close().await;
        Ok(Self { store: open_read_only(&copy).await?, schema: found, _copy: Some(folder) })
    }
}

impl Store {
    /// SQLite's own integrity findings, and dangling rows. PostgreSQL has none: it enforces references itself.
    pub(crate) async fn integrity(&self) -> Result<Vec<(String, String)>> {
        if self.is_in_postgres() {
            return Ok(Vec::new());
        }
        let fault = || fault("checking the database");
        let lines: Vec<String> =
            row::query_as("pragma integrity_check").fetch_all(self.read()).await.map_err(fault())?;
        let damage = lines.into_iter().filter(|line| line != "ok").map(|line| ("database".to_owned(), line));
        let dangling: Vec<(String, Option<i64>, String)> =
            row::query_as("select \"table\", rowid, parent from pragma_foreign_key_check")
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
    let pool = Pool::Sqlite(pool);
    Ok(Store::untied(pool.clone(), pool))
}
