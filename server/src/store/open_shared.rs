//! Opening a database for writing beside a running server: used to issue and revoke tokens while it serves.

use std::{path::Path, time::Duration};

use sqlx::sqlite::{SqliteConnectOptions, SqlitePoolOptions, SqliteSynchronous};

use super::{Store, schema, sql::Pool, sqlite::check_version};
use crate::error::{Error, Result};

/// Longest wait for a server that has just started and may still be migrating.
const STARTING: Duration = Duration::from_secs(10);
const POLL_INTERVAL: Duration = Duration::from_millis(50);

impl Store {
    /// Opens a database that a server may have open. The database is not migrated, because the server uses its schema.
    ///
    /// # Errors
    /// Precondition when the database is missing, or has another schema version than this program.
    pub(crate) async fn open_shared(path: &Path) -> Result<Self> {
        let unusable =
            |problem: String| Error::precondition(format!("cannot use the database {}: {problem}", path.display()));
        let options = SqliteConnectOptions::new()
            .filename(path)
            .foreign_keys(true)
            .synchronous(SqliteSynchronous::Full)
            .busy_timeout(Duration::from_secs(10));
        let pool = SqlitePoolOptions::new()
            .max_connections(1)
            .connect_with(options)
            .await
            .map_err(|error| unusable(error.to_string()))?;
        check_version(&pool).await?;
        let pool = Pool::Sqlite(pool);
        let migrated = tokio::time::timeout(STARTING, async {
            while schema::known(&pool, path.display()).await? != schema::newest() {
                tokio::time::sleep(POLL_INTERVAL).await;
            }
            Ok(())
        });
        let older = |_| {
            unusable("the server that uses it has an older version; use the gleaner-server of that version".to_owned())
        };
        migrated.await.map_err(older)??;
        Ok(Self::untied(pool.clone(), pool))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::Kind;

    #[tokio::test]
    async fn two_stores_write_to_one_database() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("gleaner.db");
        assert_eq!(Store::open_shared(&path).await.unwrap_err().kind(), Kind::Precondition);
        let first = Store::open(&path).await.unwrap();
        let second = Store::open_shared(&path).await.unwrap();
        let spec = super::super::testing::spec();
        let task = second.insert_task(&spec).await.unwrap();
        assert_eq!(first.task(&spec.name).await.unwrap().id, task.id);
    }
}
