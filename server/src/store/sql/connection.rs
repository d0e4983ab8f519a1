//! Pools and transactions of either database.

use sqlx::{PgConnection, PgPool, Postgres, Sqlite, SqliteConnection, SqlitePool};

/// Connections to a database.
#[derive(Debug, Clone)]
pub(in crate::store) enum Pool {
    Sqlite(SqlitePool),
    Postgres(PgPool),
}

/// A transaction; dropped, it is rolled back.
pub(in crate::store) enum Transaction {
    Sqlite(sqlx::Transaction<'static, Sqlite>),
    Postgres(sqlx::Transaction<'static, Postgres>),
}

/// What a statement runs on.
pub(in crate::store) enum Target<'e> {
    SqlitePool(&'e SqlitePool),
    Sqlite(&'e mut SqliteConnection),
    PostgresPool(&'e PgPool),
    Postgres(&'e mut PgConnection),
}

/// The start of a write on PostgreSQL: one at a time in the whole database, as SQLite's `begin immediate` has it, so that
/// what a transaction has read still holds when it writes. The key is of this program alone.
const POSTGRES_WRITE: &str = "begin; select pg_advisory_xact_lock(7236279350437208690)";

impl Pool {
    /// Begins a write. Other writers wait until it ends.
    pub(in crate::store) async fn begin_write(&self) -> sqlx::Result<Transaction> {
        match self {
            // Immediate: a transaction that becomes a write later would fail at once.
            Self::Sqlite(pool) => pool.begin_with("begin immediate").await.map(Transaction::Sqlite),
            Self::Postgres(pool) => pool.begin_with(POSTGRES_WRITE).await.map(Transaction::Postgres),
        }
    }

    /// Begins to read at one moment.
    pub(in crate::store) async fn begin_read(&self) -> sqlx::Result<Transaction> {
        match self {
            Self::Sqlite(pool) => pool.begin().await.map(Transaction::Sqlite),
            Self::Postgres(pool) => {
                pool.begin_with("begin isolation level repeatable read read only").await.map(Transaction::Postgres)
            }
        }
    }

    /// Closes every connection.
    pub(in crate::store) async fn close(&self) {
        match self {
            Self::Sqlite(pool) => pool.close().await,
            Self::Postgres(pool) => pool.close().await,
        }
    }
}

impl Transaction {
    pub(in crate::store) async fn commit(self) -> sqlx::Result<()> {
        match self {
            Self::Sqlite(transaction) => transaction.commit().await,
            Self::Postgres(transaction) => transaction.commit().await,
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

impl<'e> From<&'e mut Transaction> for Target<'e> {
    fn from(transaction: &'e mut Transaction) -> Self {
        match transaction {
            Transaction::Sqlite(transaction) => Self::Sqlite(transaction),
            Transaction::Postgres(transaction) => Self::Postgres(transaction),
        }
    }
}
