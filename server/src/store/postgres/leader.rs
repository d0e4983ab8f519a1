//! The lock that the leader of a database holds: which server has it, and the end of a connection of this server that
//! still has it without an answer.

use sqlx::PgConnection;

use super::{super::fault::connecting, Postgres};
use crate::error::{Error, Result};

/// The key of the lock that the leader of a database holds.
const LOCK: i64 = 7_236_279_350_437_208_691;

/// The connections that hold the lock in this database. The key of a lock is stored in two halves.
macro_rules! holders {
    () => {
        " from pg_catalog.pg_locks join pg_catalog.pg_stat_activity using (pid) \
         where locktype = 'advisory' and granted and (classid::bigint << 32) | objid::bigint = $1 \
         and datname = current_database() and database = datid"
    };
}

/// Takes the lock for a connection; false while another server has it. A connection of this server that holds it is one
/// that hangs, because each server has one connection that writes: it is ended.
pub(super) async fn take(connection: &mut PgConnection) -> sqlx::Result<bool> {
    let lock = "select pg_try_advisory_lock($1)";
    if sqlx::query_scalar(lock).bind(LOCK).fetch_one(&mut *connection).await? {
        return Ok(true);
    }
    let end = concat!(
        "select pg_terminate_backend(pid, 1000)",
        holders!(),
        " and application_name = current_setting('application_name') and pid <> pg_backend_pid()"
    );
    let ended: Vec<bool> = sqlx::query_scalar(end).bind(LOCK).fetch_all(&mut *connection).await?;
    if ended.is_empty() {
        return Ok(false);
    }
    tracing::warn!("a connection to PostgreSQL that gave no answer was ended, and its lock taken");
    sqlx::query_scalar(lock).bind(LOCK).fetch_one(connection).await
}

/// Rejects a database that a server uses.
pub(super) async fn expect_none(at: &Postgres, connection: &mut PgConnection) -> Result<()> {
    let doing = |error| connecting(at, error);
    let free: bool = sqlx::query_scalar("select pg_try_advisory_lock($1)")
        .bind(LOCK)
        .fetch_one(&mut *connection)
        .await
        .map_err(doing)?;
    if free {
        return Ok(());
    }
    let place = concat!("select coalesce(host(client_addr), 'the machine of the database')", holders!(), " limit 1");
    let place: Option<String> = sqlx::query_scalar(place).bind(LOCK).fetch_optional(connection).await.map_err(doing)?;
    let place = place.map(|place| format!(", connected from {place}")).unwrap_or_default();
    Err(Error::precondition(format!(
        "{at}: another gleaner-server uses this database{place}. A database has one server: stop the other one, or name \
         another database with --database"
    )))
}
