//! The database: the only module with SQL. One file per family of tables; what only one of the databases knows is in
//! `sqlite` and the files that open or copy one, and in `postgres`.
//!
//! One connection writes, several read. Every write is on disk when the call returns. Arguments and results are domain
//! values.

pub(crate) mod attempt;
mod audit;
pub(crate) mod backlog;
mod blob;
mod check;
mod clock;
mod copy;
mod curation;
mod database;
mod dataset;
mod deployment;
mod dump;
mod encoder;
mod episode;
mod evaluation;
mod export;
mod fault;
pub(crate) mod finish;
mod follow;
mod job;
mod kept;
mod lab;
mod metric;
mod missing_result;
mod open_shared;
mod packed;
mod page;
mod policy;
pub(crate) mod postgres;
pub(crate) mod queue;
mod read_only;
mod role;
mod row;
mod schedule;
mod schema;
mod score;
mod sidecar;
mod snapshot;
mod sql;
mod sqlite;
mod task;
#[cfg(test)]
pub(crate) mod testing;
mod tie;
mod token;
mod transfer;
mod trash;
mod upload;

use std::sync::{Arc, OnceLock};

pub(crate) use self::{
    blob::NamedBlob, database::Database, dataset::KeptDetail, postgres::Postgres, read_only::ReadOnlyDatabase,
    schema::newest as newest_schema, sidecar::Described,
};
use self::{
    fault::fault,
    sql::{Pool, Transaction},
};
use crate::error::Result;

/// Handle to the database; clones share it.
#[derive(Debug, Clone)]
pub struct Store {
    writer: Pool,
    readers: Pool,
    /// The link of a server's database to its folder; empty for a database that is only read.
    tie: Arc<OnceLock<tie::Tie>>,
    /// The role of a server that was started as a standby; `None`: it leads.
    role: Option<Arc<role::Role>>,
}

impl Store {
    /// A store that is tied to no folder.
    fn untied(writer: Pool, readers: Pool) -> Self {
        Self { writer, readers, tie: Arc::default(), role: None }
    }

    /// Closes every connection; SQLite's last one checkpoints the log.
    pub async fn close(&self) {
        self.readers.close().await;
        self.writer.close().await;
        if let Some(role) = &self.role {
            role.beside.close().await;
        }
    }

    /// Begins a write. Other writers wait until it ends.
    ///
    /// # Errors
    /// As [`Store::expect_leader`]; Unavailable when the database is busy or away.
    async fn write(&self) -> Result<Transaction> {
        if let Some(role) = &self.role {
            role.expect_writer()?;
        }
        self.writer.begin_write().await.map_err(fault("beginning a write"))
    }

    /// Begins a write that a standby makes too: of rows that the leader holds in no memory and that belong to no blob.
    async fn write_beside(&self) -> Result<Transaction> {
        let writer = match &self.role {
            Some(role) if role.expect_writer().is_err() => &role.beside,
            Some(_) | None => &self.writer,
        };
        writer.begin_write().await.map_err(fault("beginning a write"))
    }

    /// Commits a write: it is on disk, in the database at the path, when this returns.
    ///
    /// # Errors
    /// Precondition when the database was deleted or replaced; the errors of the disk.
    async fn commit(&self, transaction: Transaction) -> Result<()> {
        transaction.commit().await.map_err(fault("committing a write"))?;
        self.verify()
    }

    /// Whether the database is in PostgreSQL, whose copies are not this server's.
    pub(crate) fn is_in_postgres(&self) -> bool {
        matches!(self.readers, Pool::Postgres(_))
    }

    /// The pool to read from.
    fn read(&self) -> &Pool {
        &self.readers
    }
}

/// Whether the error is a violated `unique` or primary key.
fn is_duplicate(error: &sqlx::Error) -> bool {
    error.as_database_error().is_some_and(sqlx::error::DatabaseError::is_unique_violation)
}

#[cfg(test)]
mod tests;
