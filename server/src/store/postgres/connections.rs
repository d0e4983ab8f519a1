//! Opening PostgreSQL: for the one server that uses a database, and for commands beside it.
//!
//! The connection that writes holds a lock of the whole session, so that every write of a server is made while no other
//! server has the database: a server whose connection was lost writes again only after it has the lock again.

use std::{
    sync::{Arc, OnceLock},
    time::Duration,
};

use sqlx::{PgConnection, PgPool};

use super::{
    super::{Store, fault::connecting, role::Role, schema, sql::Pool, tie::Tie},
    Postgres, leader,
    pool::{Begin, begin, pool},
};
use crate::{
    domain::time::Millis,
    error::{Error, Result},
};

/// Connections that read; one more writes.
const READERS: u32 = 8;
/// The difference of two clocks, in milliseconds, that causes a warning.
const CLOCKS_DIFFER: i64 = 60_000;

impl Store {
    /// Opens a database for the one server that uses it, and brings its schema up to date.
    ///
    /// # Errors
    /// Precondition when PostgreSQL cannot be reached or is too old, when it rejects the user, when another server uses
    /// the database, or when that is newer than this program.
    pub(crate) async fn serve_postgres(at: &Postgres) -> Result<Self> {
        at.expect_usable(true).await?;
        let at = &at.of_one_server();
        let doing = |error| connecting(at, error);
        let tie = Arc::<OnceLock<Tie>>::default();
        // The connection that writes stays open, because it holds the lock of this server.
        let writer = pool(at, 1, leading(&tie, at)).idle_timeout(None).max_lifetime(None);
        let writer = writer.connect_with(at.options.clone()).await.map_err(doing)?;
        let fsync: String = sqlx::query_scalar("show fsync").fetch_one(&writer).await.map_err(doing)?;
        if fsync == "off" {
            tracing::warn!(database = %at, "fsync is off in PostgreSQL: a power cut can lose acknowledged data");
        }
        schema::update(&Pool::Postgres(writer.clone()), at).await?;
        let readers = pool(at, READERS, reading()).connect_with(at.options.clone()).await.map_err(doing)?;
        warn_of_clocks(at, &readers).await?;
        Ok(Self { writer: Pool::Postgres(writer), readers: Pool::Postgres(readers), tie, role: None })
    }

    /// Opens a database that another server leads. The connection that takes the lock is opened when the lock is wanted.
    ///
    /// # Errors
    /// Precondition when it cannot be used.
    pub(in crate::store) async fn follow_postgres(at: &Postgres) -> Result<Self> {
        at.expect_usable(false).await?;
        let at = &at.of_one_server();
        let tie = Arc::<OnceLock<Tie>>::default();
        let writer = pool(at, 1, leading(&tie, at)).idle_timeout(None).max_lifetime(None);
        let writer = writer.connect_lazy_with(at.options.clone());
        let wait = at.timeout;
        let beside = pool(at, 1, begin(move |connection| Box::pin(writing(connection, wait))));
        let beside = beside.connect_lazy_with(at.options.clone());
        let readers = pool(at, READERS, reading()).connect_with(at.options.clone()).await;
        let readers = readers.map_err(|error| connecting(at, error))?;
        warn_of_clocks(at, &readers).await?;
        let role = Some(Arc::new(Role::standby(Pool::Postgres(beside))));
        Ok(Self { writer: Pool::Postgres(writer), readers: Pool::Postgres(readers), tie, role })
    }

    /// Opens a database to read it, of any schema or none.
    ///
    /// # Errors
    /// Precondition when it cannot be used.
    pub(crate) async fn look_at(at: &Postgres) -> Result<Self> {
        at.expect_usable(false).await?;
        let options = at.options.clone().options([("default_transaction_read_only", "on")]);
        let pool = pool(at, 1, reading()).connect_with(options).await.map_err(|error| connecting(at, error))?;
        Ok(Self::untied(Pool::Postgres(pool.clone()), Pool::Postgres(pool)))
    }

    /// Opens a database that a server may use, for a few writes of a command.
    ///
    /// # Errors
    /// Precondition when it cannot be used, is empty, or has another schema than this program.
    pub(crate) async fn open_beside(at: &Postgres) -> Result<Self> {
        at.expect_usable(false).await?;
        let wait = at.timeout;
        let begin = begin(move |connection| Box::pin(writing(connection, wait)));
        let pool = pool(at, 1, begin).connect_with(at.options.clone()).await.map_err(|error| connecting(at, error))?;
        let pool = Pool::Postgres(pool);
        match schema::known(&pool, at).await? {
            found if found == schema::newest() => Ok(Self::untied(pool.clone(), pool)),
            0 => Err(Error::precondition(format!("{at}: the database is empty; start a server with it first"))),
            found => Err(Error::precondition(format!(
                "{at}: the database has schema version {found}, and this program {}; start its server once, or use the \
                 gleaner-server of that version",
                schema::newest()
            ))),
        }
    }
}

/// Warns when the clock of this machine differs from that of PostgreSQL, and so probably from that of other servers.
async fn warn_of_clocks(at: &Postgres, readers: &PgPool) -> Result<()> {
    if let Some(problem) = problem_of_clocks(at, readers, Millis::now).await? {
        tracing::warn!(database = %at, "{problem}");
    }
    Ok(())
}

/// A sentence about the clock of PostgreSQL, if it differs from that of this machine, which `now` reads.
async fn problem_of_clocks(at: &Postgres, readers: &PgPool, now: impl FnOnce() -> Millis) -> Result<Option<String>> {
    let theirs = sqlx::query_scalar("select cast(floor(extract(epoch from clock_timestamp()) * 1000) as bigint)");
    let theirs: i64 = theirs.fetch_one(readers).await.map_err(|error| connecting(at, error))?;
    // After the answer, which may have waited for a connection. Both times are whole milliseconds that have passed, so that
    // one clock is never behind itself.
    Ok(clocks(now().0, theirs))
}

/// A sentence about two clocks that differ, in milliseconds.
fn clocks(ours: i64, theirs: i64) -> Option<String> {
    let difference = ours.saturating_sub(theirs);
    (difference.abs() >= CLOCKS_DIFFER).then(|| {
        let (seconds, side) = (difference.abs() / 1000, if difference > 0 { "ahead of" } else { "behind" });
        format!(
            "the clock of this machine is {seconds} seconds {side} that of PostgreSQL: tokens expire, schedules begin and \
             rows are dated by the clock of each server. Synchronise both machines, for example by chrony"
        )
    })
}

/// The beginning of connections that read.
fn reading() -> Begin {
    begin(|_| Box::pin(async { Ok(()) }))
}

/// The beginning of the connection that writes for the one server.
fn leading(tie: &Arc<OnceLock<Tie>>, at: &Postgres) -> Begin {
    let (tie, wait) = (Arc::clone(tie), at.timeout);
    begin(move |connection| {
        let tie = Arc::clone(&tie);
        Box::pin(async move { take_over(connection, &tie, wait).await })
    })
}

/// Makes a connection the one that writes: with the lock of the one server, to a database that has everything that was
/// acknowledged. The database may be a replica that took over and had not received all of it.
async fn take_over(connection: &mut PgConnection, tie: &OnceLock<Tie>, wait: Duration) -> sqlx::Result<()> {
    writing(connection, wait).await?;
    if !leader::take(connection).await? {
        return Err(sqlx::Error::Configuration("another server has the database".into()));
    }
    let Some(tie) = tie.get() else { return Ok(()) };
    let (folder, generation): (String, i64) =
        sqlx::query_as("select folder, generation from lab").fetch_one(connection).await?;
    match tie.is_still(&folder, u64::try_from(generation).unwrap_or(0)) {
        true => Ok(()),
        false => Err(sqlx::Error::Configuration("the database is not the one that the server used".into())),
    }
}

/// Prepares a connection for writes. A commit returns once it is on disk, also where the database is set up to return
/// earlier; a stricter setting, of a database with replicas, stays. The wait for other writers ends before the longest
/// silence, so that it has an error of its own.
async fn writing(connection: &mut PgConnection, wait: Duration) -> sqlx::Result<()> {
    let on = "select set_config('synchronous_commit', 'on', false) where current_setting('synchronous_commit') = 'off'";
    sqlx::query(on).execute(&mut *connection).await?;
    let wait = format!("{}s", wait.as_secs().saturating_sub(1).max(1));
    sqlx::query("select set_config('lock_timeout', $1, false)").bind(wait).execute(connection).await?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::{Millis, clocks, problem_of_clocks};
    use crate::store::{Store, sql::Pool, testing};

    #[test]
    fn clocks_that_differ_by_a_minute_are_reported() {
        let hour = 60 * 60 * 1000;
        assert_eq!(clocks(hour, hour + 59_000), None);
        let ahead = clocks(2 * hour, hour).unwrap();
        assert!(ahead.contains("3600 seconds ahead of") && ahead.contains("Synchronise"), "{ahead}");
        assert!(clocks(hour, 2 * hour).unwrap().contains("3600 seconds behind"));
    }

    #[tokio::test]
    async fn clock_of_this_machine_is_compared_with_that_of_postgresql() {
        if !testing::postgres_selected() {
            return;
        }
        let at = testing::postgres().await;
        let store = Store::serve_postgres(&at).await.unwrap();
        let Pool::Postgres(readers) = &store.readers else { panic!("not PostgreSQL") };
        assert_eq!(problem_of_clocks(&at, readers, Millis::now).await.unwrap(), None);
        // Half a minute more than an hour, so that a clock which is set while the test runs leaves the first two digits.
        let difference = Duration::from_secs(60 * 60 + 30);
        let ahead = problem_of_clocks(&at, readers, || Millis::now().after(difference)).await.unwrap().unwrap();
        assert!(ahead.contains("the clock of this machine is 36") && ahead.contains("ahead of that of"), "{ahead}");
        let before = || Millis::of(Millis::now().time() - difference);
        let behind = problem_of_clocks(&at, readers, before).await.unwrap().unwrap();
        assert!(behind.contains("seconds behind that of PostgreSQL"), "{behind}");
    }
}
