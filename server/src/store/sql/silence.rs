//! The longest silence of PostgreSQL. A connection that hangs without an error, as after a cut cable, would block its call
//! until the system gives it up, which takes minutes; here its call fails, and its pool replaces it. Must not depend on
//! statements.

use std::{io, time::Duration};

use futures::{
    StreamExt as _,
    stream::{self, BoxStream},
};
use sqlx::PgPool;

/// The longest silence on the connections of a pool, which is also its longest wait for a connection.
pub(super) fn limit(pool: &PgPool) -> Duration {
    pool.options().get_acquire_timeout()
}

/// The result of one exchange with PostgreSQL, or an error of the connection when that takes longer than the limit.
pub(in crate::store) async fn within<T>(
    limit: Duration,
    exchange: impl Future<Output = sqlx::Result<T>>,
) -> sqlx::Result<T> {
    tokio::time::timeout(limit, exchange).await.unwrap_or_else(|_| Err(silent(limit)))
}

/// Rows that end with an error of the connection when one of them takes longer than the limit; the first one has a limit
/// of its own.
pub(super) fn rows_within<'e, T: Send + 'e>(
    first: Duration,
    later: Duration,
    rows: BoxStream<'e, sqlx::Result<T>>,
) -> BoxStream<'e, sqlx::Result<T>> {
    let next = move |state: Option<(Duration, BoxStream<'e, sqlx::Result<T>>)>| async move {
        let (limit, mut rows) = state?;
        match tokio::time::timeout(limit, rows.next()).await {
            Ok(row) => Some((row?, Some((later, rows)))),
            Err(_) => Some((Err(silent(limit)), None)),
        }
    };
    stream::unfold(Some((first, rows)), next).fuse().boxed()
}

fn silent(limit: Duration) -> sqlx::Error {
    let seconds = limit.as_secs();
    let text = format!("PostgreSQL sent nothing for {seconds} seconds (--database-timeout-seconds)");
    sqlx::Error::Io(io::Error::new(io::ErrorKind::TimedOut, text))
}
