//! Copies of a database, made while others read and write it.

use std::path::Path;

use sqlx::sqlite::{SqliteConnectOptions, SqliteJournalMode, SqlitePoolOptions};

use super::{
    Store, fault, lab,
    read_only::open_read_only,
    schema,
    sql::{self, Pool},
};
use crate::error::{Error, Result};

impl Store {
    /// Copies the database at `from`, of any schema, to a new file at `to`, without open uploads, whose files are not
    /// copied.
    ///
    /// # Errors
    /// As for [`ReadOnlyDatabase::open`] and [`Store::copy_to`].
    pub(crate) async fn copy(from: &Path, to: &Path) -> Result<()> {
        let source = open_read_only(from).await?;
        schema::known(&source.readers, from.display()).await?;
        source.copy_to(to).await?;
        source.close().await;
        let options = SqliteConnectOptions::new().filename(to).journal_mode(SqliteJournalMode::Delete);
        let pool = SqlitePoolOptions::new().max_connections(1).connect_with(options).await;
        let pool = Pool::Sqlite(pool.map_err(fault("opening the copy"))?);
        sql::query("delete from uploads").execute(&pool).await.map_err(fault("leaving uploads out"))?;
        lab::detach(&pool).await?;
        pool.close().await;
        Ok(())
    }

    /// Writes the database at one moment to a new, self-contained file, while others read and write.
    ///
    /// `VACUUM INTO` reads in one transaction, which in WAL mode does not block others. SQLite's backup API starts
    /// again whenever another process has written, so a busy server could keep a backup from ever ending.
    ///
    /// # Errors
    /// Precondition when the database is in PostgreSQL; Exhausted when the disk is full; Internal when the database is damaged or the file exists already.
    pub(crate) async fn copy_to(&self, path: &Path) -> Result<()> {
        if self.is_in_postgres() {
            return Err(Error::precondition("the database is in PostgreSQL: copy it with `pg_dump`"));
        }
        sql::query("vacuum into $1")
            .bind(path.display().to_string())
            .execute(&self.readers)
            .await
            .map_err(fault("copying the database"))?;
        Ok(())
    }
}
