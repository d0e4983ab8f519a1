//! Pools and transactions of either database.

use std::time::Duration;

use sqlx::{PgConnection, PgPool, Postgres, Sqlite, SqliteConnection, SqlitePool};

use super::silence::{self, within};

/// Connections to a database.
#[derive(Debug, Clone)]
pub(in crate::store) enum Pool {
    Sqlite(SqlitePool),
    Postgres(PgPool),
}

/// A transaction; dropped, it is rolled back.
pub(in crate::store) enum Transaction {
    Sqlite(sqlx::Transaction<'static, Sqlite>),
    /// With the longest silence of its connection.
    Postgres(sqlx::Transaction<'static, Postgres>, Duration),
}

/// What a statement runs on.
pub(in crate::store) enum Target<'e> {
    SqlitePool(&'e SqlitePool),
    Sqlite(&'e mut SqliteConnection),
    PostgresPool(&'e PgPool),
    /// With the longest silence of the connection.
    Postgres(&'e mut PgConnection, Duration),
}

/// The start of a write on PostgreSQL: one at a time in the whole database, as SQLite's `begin immediate` has it, so that
/// what a transaction has read still holds when it writes. The key is of this program alone. The standbys of a leader are
/// notified of the commit.
const POSTGRES_WRITE: &str = "begin; select pg_advisory_xact_lock(7236279350437208690); notify gleaner_changes";
/// The channel of that notification.
pub(in crate::store) const CHANGES: &str = "gleaner_changes";

impl Pool {
    /// Begins a write. Other writers wait until it ends.
    pub(in crate::store) async fn begin_write(&self) -> sqlx::Result<Transaction> {
        match self {
            // Immediate: a transaction that becomes a write later would fail at once.
            Self::Sqlite(pool) => pool.begin_with("begin immediate").await.map(Transaction::Sqlite),
            Self::Postgres(pool) => begin(pool, POSTGRES_WRITE).await,
        }
    }

    /// Begins to read at one moment.
    pub(in crate::store) async fn begin_read(&self) -> sqlx::Result<Transaction> {
        match self {
            Self::Sqlite(pool) => pool.begin().await.map(Transaction::Sqlite),
            Self::Postgres(pool) => begin(pool, "begin isolation level repeatable read read only").await,
        }
    }

    /// Closes every connection.
    pub(in crate::store) async fn close(&self) {
        match self {
            Self::Sqlite(pool) => pool.close().await,
            Self::Postgres(pool) => {
                // A connection that hangs must not delay the end of the process.
                let _: Result<(), _> = tokio::time::timeout(silence::limit(pool), pool.close()).await;
            }
        }
    }
}

impl Transaction {
    pub(in crate::store) async fn commit(self) -> sqlx::Result<()> {
        match self {
            Self::Sqlite(transaction) => transaction.commit().await,
            Self::Postgres(transaction, limit) => within(limit, transaction.commit()).await,
        }
    }
}

impl<'e> From<&'e Pool> for Target<'e> {
    fn from(pool: &'e Pool) -> Self {
        match pool {
            Pool::Sqlite(pool) => Self::SqlitePool(pool),
            Pool::Postgres(pool) => Self::PostgresPool(pool),
        }
    }
}

async fn begin(pool: &PgPool, statement: &'static str) -> sqlx::Result<Transaction> {
    let limit = silence::limit(pool);
    // The wait for a connection, which has the same limit, comes first.
    let transaction = within(limit * 2, pool.begin_with(statement)).await?;
    Ok(Transaction::Postgres(transaction, limit))
}

impl<'e> From<&'e mut Transaction> for Target<'e> {
    fn from(transaction: &'e mut Transaction) -> Self {
        match transaction {
            Transaction::Sqlite(transaction) => Self::Sqlite(transaction),
            Transaction::Postgres(transaction, limit) => Self::Postgres(transaction, *limit),
        }
    }
}
