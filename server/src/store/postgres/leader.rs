//! The lock that the leader of a database holds: which server has it, and the end of a connection of this server that
//! still has it without an answer.

use std::net::{IpAddr, SocketAddr};

use sqlx::{PgConnection, PgPool};

use super::{
    super::{fault::connecting, sql::within},
    Postgres,
};
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

/// Whether any connection holds the lock.
pub(super) async fn is_led(connection: &mut PgConnection) -> sqlx::Result<bool> {
    let held = concat!("select exists (select 1", holders!(), ")");
    sqlx::query_scalar(held).bind(LOCK).fetch_one(connection).await
}

/// The address of the server that holds the lock, other than the one of this pool.
pub(in crate::store) async fn leader(pool: &PgPool) -> sqlx::Result<Option<String>> {
    let found = concat!(
        "select application_name, host(client_addr)",
        holders!(),
        " and application_name <> current_setting('application_name') limit 1"
    );
    let mut connection = pool.acquire().await?;
    let found = sqlx::query_as(found).bind(LOCK).fetch_optional(&mut *connection);
    let found: Option<(String, Option<String>)> = within(pool.options().get_acquire_timeout(), found).await?;
    Ok(found.map(|(name, machine)| address(&name, machine.as_deref())))
}

/// The address for calls of a server by the name of its connection, from this machine.
fn address(name: &str, machine: Option<&str>) -> String {
    let machine = machine.and_then(|machine| machine.parse::<IpAddr>().ok());
    let listen = name.rsplit(' ').next().and_then(|listen| listen.parse::<SocketAddr>().ok());
    match (listen, machine) {
        (Some(listen), Some(machine)) if listen.ip().is_unspecified() => {
            SocketAddr::new(machine, listen.port()).to_string()
        }
        (Some(listen), None) if listen.ip().is_unspecified() => {
            format!("port {} of the machine of the database", listen.port())
        }
        (Some(listen), _) => listen.to_string(),
        (None, Some(machine)) => format!("{machine} ({name})"),
        (None, None) => format!("the machine of the database ({name})"),
    }
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
        "{at}: another gleaner-server uses this database{place}. Stop the other one, start this one as its standby with \
         --standby, or name another database with --database"
    )))
}

#[cfg(test)]
mod tests {
    use super::address;

    #[test]
    fn leader_is_named_by_an_address_that_others_reach() {
        for (name, machine, expected) in [
            ("gleaner 0a1b2c 10.0.0.5:7400", Some("10.0.0.9"), "10.0.0.5:7400"),
            ("gleaner 0a1b2c 0.0.0.0:7400", Some("10.0.0.9"), "10.0.0.9:7400"),
            ("gleaner 0a1b2c [::]:7400", Some("fd00::9"), "[fd00::9]:7400"),
            ("gleaner 0a1b2c 0.0.0.0:7400", None, "port 7400 of the machine of the database"),
            ("gleaner 0a1b2c", None, "the machine of the database (gleaner 0a1b2c)"),
        ] {
            assert_eq!(address(name, machine), expected, "{name}");
        }
        let longest = "gleaner 0a1b2c [1111:2222:3333:4444:5555:6666:7777:8888]:65535";
        assert!(longest.len() <= 63, "PostgreSQL cuts names of connections");
        assert_eq!(address(longest, None), "[1111:2222:3333:4444:5555:6666:7777:8888]:65535");
    }
}
