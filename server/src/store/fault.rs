//! The causes of database errors: a full disk, a slow disk, or a defect.

use crate::{
    error::{DISK_FULL, DISK_READ_ONLY, Error},
    file_limit::largest_file,
};

/// SQLite reports a write beyond the process's file size limit as any other write that failed.
const FILE_LIMIT_REACHED: &str = "the server's database cannot be written: its files have reached the file size limit \
     of the server's process, or the disk fails. No part of this request was stored. Raise the limit (`ulimit -f`, \
     LimitFSIZE= of its service), then retry";

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
    Error::unavailable("the server's database is busy: its disk is slow or another process holds it; retry")
}

#[cfg(test)]
mod tests {
    use super::super::{ReadOnlyDatabase, testing};
    use crate::{domain::episode::Outcome, error::Kind};

    /// SQLite reports a database at its maximum size in the same way as a full disk.
    #[tokio::test]
    async fn a_full_disk_refuses_writes_until_there_is_room() {
        let (_dir, store) = testing::store().await;
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
        assert!(error.message().contains("disk is full") && error.to_string().contains("opening an upload"), "{error}");
        assert_eq!(store.tasks().await.unwrap().len(), 1, "reading still works");
        // SQLite has rolled back automatically: the connection must not stay in the ended transaction.
        let again = store.insert_upload(&testing::upload(&task, &[7; 100]), None).await.err().map(|error| error.kind());
        assert!(matches!(again, None | Some(Kind::Exhausted)), "{again:?}");
        testing::run(&store, &format!("{pages}1000000")).await;
        testing::episode(&store, &task, Outcome::Success, "").await;
    }

    #[tokio::test]
    async fn an_unwritable_database_is_reported_as_such() {
        let (dir, store) = testing::store().await;
        let task = testing::task(&store).await;
        store.close().await;
        let database = ReadOnlyDatabase::open(&dir.path().join("gleaner.db")).await.unwrap();
        let error = database.store.insert_upload(&testing::upload(&task, b"x"), None).await.unwrap_err();
        assert_eq!(error.kind(), Kind::Exhausted, "{error}");
        assert!(error.message().contains("cannot be written"), "{error}");
    }

    /// The end-to-end tests have a real limit; this test covers every code.
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
        let (_dir, store) = testing::store().await;
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
