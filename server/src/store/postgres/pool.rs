//! Pools of connections to PostgreSQL that replace a connection which hangs. Must not depend on the meaning of locks.

use std::{sync::Arc, time::Duration};

use futures::future::BoxFuture;
use sqlx::{
    Connection as _, Executor as _, PgConnection,
    postgres::{PgConnectOptions, PgPoolOptions},
};

use super::{super::sql::within, Postgres};

/// The part of the longest silence in which an idle connection must answer before it is used, a used one before others
/// may use it, and a new one in place of one that hangs: the same call can then use another connection.
const PING_PART: u32 = 4;

/// What a new connection does first.
pub(super) type Begin = Arc<dyn for<'c> Fn(&'c mut PgConnection) -> BoxFuture<'c, sqlx::Result<()>> + Send + Sync>;

/// The beginning that a closure describes.
pub(super) fn begin<F>(first: F) -> Begin
where
    F: for<'c> Fn(&'c mut PgConnection) -> BoxFuture<'c, sqlx::Result<()>> + Send + Sync + 'static,
{
    Arc::new(first)
}

/// A pool of up to this many connections, each of which begins in the same way.
pub(super) fn pool(at: &Postgres, connections: u32, begin: Begin) -> PgPoolOptions {
    let (limit, options) = (at.timeout, at.options.clone());
    let ping = limit / PING_PART;
    let first = Arc::clone(&begin);
    PgPoolOptions::new()
        .max_connections(connections)
        .acquire_timeout(limit)
        .after_connect(move |connection, _| first(connection))
        // Unlike sqlx's own test, with a limit: a connection that hangs is replaced and fails no call.
        .test_before_acquire(false)
        .before_acquire(move |connection, _| {
            Box::pin(async move { within(ping, connection.ping()).await.map(|()| true) })
        })
        .after_release(move |connection, _| {
            let (options, begin) = (options.clone(), Arc::clone(&begin));
            Box::pin(async move { release(connection, ping, &options, &begin).await.map(|()| true) })
        })
}

/// Makes a connection fit for its next use. A transaction whose beginning was interrupted, by a caller that is gone or a
/// lock that was not had, is open in PostgreSQL and unknown to sqlx.
async fn release(
    connection: &mut PgConnection,
    ping: Duration,
    options: &PgConnectOptions,
    begin: &Begin,
) -> sqlx::Result<()> {
    match within(ping, connection.execute("rollback")).await {
        Ok(_) => return Ok(()),
        Err(sqlx::Error::Io(error)) if error.kind() == std::io::ErrorKind::TimedOut => {}
        Err(error) => return Err(error),
    }
    // The pool would close it by first sending what is buffered, which hangs as well. Dropped, it sends nothing.
    let mut attempts = tokio::time::interval(ping);
    loop {
        attempts.tick().await;
        let fresh = within(ping, async {
            let mut fresh = PgConnection::connect_with(options).await?;
            begin(&mut fresh).await?;
            Ok(fresh)
        });
        match fresh.await {
            Ok(fresh) => {
                *connection = fresh;
                return Ok(());
            }
            Err(error) => tracing::warn!(%error, "a connection to PostgreSQL hangs and cannot be replaced yet"),
        }
    }
}
