//! The causes of database errors: a full disk, a slow disk, a database that is away, or a defect.

use std::fmt::Display;

use sqlx::postgres::PgDatabaseError;

use crate::{
    error::{DISK_FULL, DISK_READ_ONLY, Error},
    file_limit::largest_file,
};

/// SQLite reports a write beyond the process's file size limit as any other write that failed.
const FILE_LIMIT_REACHED: &str = "the server's database cannot be written: its files have reached the file size limit \
     of the server's process, or the disk fails. No part of this request was stored. Raise the limit (`ulimit -f`, \
     LimitFSIZE= of its service), then retry";

/// The messages in place of [`DISK_FULL`] and [`DISK_READ_ONLY`] for PostgreSQL, whose disk is not that of the data folder.
const POSTGRES_FULL: &str = "the disk of PostgreSQL (--database) is full: no part of this request was stored. Free some \
     space there, then retry";
const POSTGRES_READ_ONLY: &str = "PostgreSQL (--database) accepts no writes, because it is a standby or its disk fails: no \
     part of this request was stored. Repair it, or name its primary with --database, then retry";

/// SQLite's codes, extended ones where they are needed.
const BUSY: i32 = 5;
const READ_ONLY: i32 = 8;
const FULL: i32 = 13;
/// The codes of writing, syncing, truncating a file, and extending the index of the log.
const WRITE_FAILED: [i32; 5] = [778, 1034, 1290, 1546, 4874];

/// Converts a database error into [`Error`], with the action that failed.
pub(super) fn fault(doing: &'static str) -> impl FnOnce(sqlx::Error) -> Error {
    move |error| {
        if matches!(error, sqlx::Error::PoolTimedOut) {
            return too_slow();
        }
        // SQLite has no connection to lose.
        if matches!(error, sqlx::Error::Io(_) | sqlx::Error::Tls(_)) {
            return away(doing, error);
        }
        if let Some(code) = error.as_database_error().and_then(|error| error.try_downcast_ref::<PgDatabaseError>()) {
            return match cause(code.code()) {
                Cause::Full => Error::refused_by_disk(POSTGRES_FULL, doing, error),
                Cause::Unwritable => Error::refused_by_disk(POSTGRES_READ_ONLY, doing, error),
                Cause::Busy => too_slow(),
                Cause::Away => away(doing, error),
                Cause::Text => Error::invalid("text", "contains a NUL character, which cannot be stored"),
                Cause::Defect => Error::internal(doing, error),
            };
        }
        let code = error.as_database_error().and_then(|error| error.code()?.parse::<i32>().ok());
        match code {
            Some(code) if code & 0xff == BUSY => too_slow(),
            Some(code) => match refusal(code, largest_file().is_some()) {
                Some(why) => Error::refused_by_disk(why, doing, error),
                None => Error::internal(doing, error),
            },
            None => Error::internal(doing, error),
        }
    }
}

/// The disk's fault behind an error, if there is one. `limited`: this process has a file size limit.
fn refusal(code: i32, limited: bool) -> Option<&'static str> {
    match code {
        FULL => Some(DISK_FULL),
        code if WRITE_FAILED.contains(&code) && limited => Some(FILE_LIMIT_REACHED),
        code if code & 0xff == READ_ONLY || WRITE_FAILED.contains(&code) => Some(DISK_READ_ONLY),
        _ => None,
    }
}

fn too_slow() -> Error {
    Error::unavailable(
        "the server's database is busy or does not answer: its disk is slow, another process holds it, or its connection \
         hangs; retry",
    )
}

fn away(doing: &'static str, error: sqlx::Error) -> Error {
    tracing::warn!(%error, "the database was away: {doing}");
    Error::unavailable("the server's database cannot be reached, or was restarted; retry")
}

/// What PostgreSQL's SQLSTATE means to a caller.
#[derive(Debug, PartialEq, Eq)]
enum Cause {
    Full,
    Unwritable,
    Busy,
    Away,
    Text,
    Defect,
}

fn cause(code: &str) -> Cause {
    match code {
        "53100" => Cause::Full,
        // A standby, or a server that was made one; a disk that fails.
        "25006" | "58030" => Cause::Unwritable,
        // Serialisation failures, deadlocks and locks waited for too long.
        "40001" | "40P01" | "55P03" => Cause::Busy,
        "22021" => Cause::Text,
        code if ["08", "53", "57P"].iter().any(|class| code.starts_with(class)) => Cause::Away,
        _ => Cause::Defect,
    }
}

const CERTIFICATE: &str = "check the certificate of PostgreSQL, and `sslmode` and `sslrootcert` in --database";

/// The error of a database that cannot be opened, for its operator.
pub(super) fn connecting(shown: impl Display, error: sqlx::Error) -> Error {
    let code = error.as_database_error().and_then(|error| error.code()).unwrap_or_default().into_owned();
    let help = match (&error, code.as_str()) {
        (sqlx::Error::PoolTimedOut, _) => {
            return Error::precondition(format!(
                "{shown}: PostgreSQL did not answer in time (--database-timeout-seconds); check the host and port of --database, and that its \
                 server runs"
            ));
        }
        // A certificate that the TLS of the client rejects.
        (sqlx::Error::Io(error), _) if error.kind() == std::io::ErrorKind::InvalidData => CERTIFICATE,
        (sqlx::Error::Io(_), _) => "check the host and port of --database, and that its server runs",
        (sqlx::Error::Tls(_), _) => CERTIFICATE,
        (_, "28P01" | "28000") => {
            "PostgreSQL rejects the user or the password; set --database-password-file, or PGPASSWORD or PGPASSFILE"
        }
        (_, "3D000") => "create the database with `createdb`",
        (_, "53300") => "raise `max_connections` of PostgreSQL; a server uses up to 10",
        (_, "42501") => "the user must own the database, or its schema `public`",
        (_, "57P03") => "PostgreSQL is starting or stopping; retry",
        _ => return Error::internal(format!("opening {shown}"), error),
    };
    Error::precondition(format!("cannot open the database {shown}: {error}. {help}"))
}

#[cfg(test)]
mod tests {
    use super::super::{ReadOnlyDatabase, Store, testing};
    use crate::{domain::episode::Outcome, error::Kind};

    /// SQLite reports a database at its maximum size in the same way as a full disk.
    #[tokio::test]
    async fn a_full_disk_refuses_writes_until_there_is_room() {
        let (_dir, store) = testing::sqlite().await;
        let task = testing::task(&store).await;
        let pages = "pragma max_page_count = ";
        testing::run(&store, &format!("{pages}1")).await;
        let mut refused = None;
        for _ in 0..1000 {
            let upload = testing::upload(&task, &[7; 100]);
            if let Err(error) = store.insert_upload(&upload, None).await {
                refused = Some(error);
                break;
            }
        }
        let error = refused.unwrap();
        assert_eq!(error.kind(), Kind::Exhausted, "{error}");
        assert!(error.message().contains("disk is full") && error.message().contains("--data-dir"), "{error}");
        assert!(error.to_string().contains("opening an upload"), "{error}");
        assert_eq!(store.tasks().await.unwrap().len(), 1, "reading still works");
        // SQLite has rolled back automatically: the connection must not stay in the ended transaction.
        let again = store.insert_upload(&testing::upload(&task, &[7; 100]), None).await.err().map(|error| error.kind());
        assert!(matches!(again, None | Some(Kind::Exhausted)), "{again:?}");
        testing::run(&store, &format!("{pages}1000000")).await;
        testing::episode(&store, &task, Outcome::Success, "").await;
    }

    #[tokio::test]
    async fn an_unwritable_database_is_reported_as_such() {
        let (dir, store) = testing::sqlite().await;
        let task = testing::task(&store).await;
        store.close().await;
        let database = ReadOnlyDatabase::open(&dir.path().join("gleaner.db")).await.unwrap();
        let error = database.store.insert_upload(&testing::upload(&task, b"x"), None).await.unwrap_err();
        assert_eq!(error.kind(), Kind::Exhausted, "{error}");
        assert!(error.message().contains("cannot be written") && error.message().contains("--data-dir"), "{error}");
    }

    #[tokio::test]
    async fn a_postgresql_without_writes_is_reported_with_its_own_flag() {
        if !testing::postgres_selected() {
            return;
        }
        let store = Store::serve_postgres(&testing::postgres().await).await.unwrap();
        let task = testing::task(&store).await;
        testing::set_read_only(&store, true).await;
        let error = store.insert_upload(&testing::upload(&task, b"x"), None).await.unwrap_err();
        assert_eq!(error.kind(), Kind::Exhausted, "{error}");
        assert!(error.message().contains("--database") && !error.message().contains("--data-dir"), "{error}");
        testing::set_read_only(&store, false).await;
        assert!(store.insert_upload(&testing::upload(&task, b"x"), None).await.unwrap());
    }

    /// The end-to-end tests have a real limit; this test covers every code.
    #[test]
    fn codes_of_postgresql_have_their_cause() {
        use super::{Cause, cause};
        for (code, expected) in [
            ("53100", Cause::Full),
            ("58030", Cause::Unwritable),
            ("25006", Cause::Unwritable),
            ("40001", Cause::Busy),
            ("55P03", Cause::Busy),
            ("08006", Cause::Away),
            ("53300", Cause::Away),
            ("57P01", Cause::Away),
            ("57P03", Cause::Away),
            ("57014", Cause::Defect),
            ("23505", Cause::Defect),
        ] {
            assert_eq!(cause(code), expected, "{code}");
        }
    }

    #[test]
    fn a_failed_write_of_a_process_with_a_file_size_limit_names_the_limit() {
        use super::{DISK_FULL, DISK_READ_ONLY, FILE_LIMIT_REACHED, FULL, READ_ONLY, WRITE_FAILED, refusal};
        for code in WRITE_FAILED {
            assert_eq!((refusal(code, true), refusal(code, false)), (Some(FILE_LIMIT_REACHED), Some(DISK_READ_ONLY)));
        }
        assert_eq!((refusal(FULL, true), refusal(READ_ONLY, true)), (Some(DISK_FULL), Some(DISK_READ_ONLY)));
        assert_eq!(refusal(1, true), None);
    }

    #[tokio::test]
    async fn an_unreadable_column_is_an_internal_error_with_its_name() {
        let (_dir, store) = testing::sqlite().await;
        let task = testing::task(&store).await;
        let episode = testing::episode(&store, &task, Outcome::Success, "").await;
        testing::run(&store, "pragma ignore_check_constraints = 1").await;
        let whole = format!("outcome = 'success', recording = '{}', steps = 20", episode.recording);
        for (column, value) in [("outcome", "'won'"), ("recording", "'abc'"), ("steps", "-1")] {
            testing::run(&store, &format!("update episodes set {whole}")).await;
            testing::run(&store, &format!("update episodes set {column} = {value}")).await;
            let error = store.episode(&episode.id).await.unwrap_err();
            assert_eq!(error.kind(), Kind::Internal, "{error}");
            let named = format!("reading an episode: error occurred while decoding column \"{column}\": ");
            assert!(error.to_string().starts_with(&named), "{error}");
        }
        testing::run(&store, "update tasks set spec = '{'").await;
        let error = store.tasks().await.unwrap_err();
        assert!(error.to_string().starts_with("listing tasks: ") && error.to_string().contains("\"spec\""), "{error}");
    }

    /// A slow disk delays writers, but no reader.
    #[tokio::test]
    async fn a_slow_write_does_not_delay_readers() {
        let (_dir, store) = testing::store().await;
        let task = testing::task(&store).await;
        let slow = store.write().await.unwrap();
        let upload = testing::upload(&task, b"waits");
        let waiting = store.insert_upload(&upload, None);
        tokio::pin!(waiting);
        assert!(futures::poll!(&mut waiting).is_pending());
        assert_eq!(store.tasks().await.unwrap().len(), 1);
        assert!(store.uploads().await.unwrap().is_empty());
        drop(slow);
        waiting.await.unwrap();
        assert_eq!(store.uploads().await.unwrap().len(), 1);
        let error = super::fault("waiting")(sqlx::Error::PoolTimedOut);
        assert!(error.kind() == Kind::Unavailable && error.message().contains("retry"), "{error}");
    }
}
