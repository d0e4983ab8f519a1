//! A database and a folder of blobs start together or not at all.

use std::fs;

use tempfile::TempDir;

use super::*;
use crate::{data_folder::beside_database, store::testing};

async fn open(dir: &Path, accept: bool) -> Result<Store> {
    Store::open_with_blobs(&Database::in_folder(dir), &Blobs::open(dir).unwrap(), accept).await
}

/// A data folder with one blob that a server has used and left.
async fn used() -> TempDir {
    let dir = tempfile::tempdir().unwrap();
    let store = open(dir.path(), false).await.unwrap();
    record(&store, dir.path(), b"first").await;
    store.close().await;
    dir
}

async fn record(store: &Store, dir: &Path, content: &[u8]) {
    Blobs::open(dir).unwrap().put(content).unwrap();
    let task = match store.task(&testing::spec().name).await {
        Ok(task) => task,
        Err(_) => testing::task(store).await,
    };
    let upload = testing::upload(&task, content);
    store.insert_upload(&upload, None).await.unwrap();
    store.finish_upload(&upload, &testing::inspected(&task, &upload)).await.unwrap();
}

/// The start is rejected with `part` of a message and the remedies, changes nothing, and `--accept-database` allows it.
async fn refused(dir: &Path, part: &str) {
    let before = fs::read(data_folder::stamp::path(dir)).ok();
    let error = open(dir, false).await.unwrap_err();
    assert_eq!(error.kind(), Kind::Precondition, "{error}");
    for part in [part, "The data folder is unchanged", "restore BACKUP", "rebuild --data-dir", "--accept-database"] {
        assert!(error.message().contains(part), "{part}: {error}");
    }
    assert_eq!(fs::read(data_folder::stamp::path(dir)).ok(), before);
    open(dir, true).await.unwrap().close().await;
    open(dir, false).await.unwrap().close().await;
    let again = open(dir, true).await.unwrap_err();
    assert!(again.message().contains("start without this flag"), "{again}");
}

#[tokio::test]
async fn the_same_database_starts_again_with_a_later_generation() {
    let dir = used().await;
    let first = Stamp::read(dir.path()).unwrap().unwrap();
    open(dir.path(), false).await.unwrap().close().await;
    let second = Stamp::read(dir.path()).unwrap().unwrap();
    assert_eq!(first.folder, second.folder);
    assert!(second.generation > first.generation);
}

#[tokio::test]
async fn blobs_without_their_database_are_refused() {
    let dir = used().await;
    fs::remove_file(data_folder::database(dir.path())).unwrap();
    refused(dir.path(), "missing or empty").await;
}

#[tokio::test]
async fn blobs_with_an_empty_database_are_refused() {
    let dir = used().await;
    fs::write(data_folder::database(dir.path()), b"").unwrap();
    refused(dir.path(), "missing or empty").await;
}

#[tokio::test]
async fn a_file_that_is_not_a_database_is_refused() {
    let dir = used().await;
    fs::write(data_folder::database(dir.path()), vec![7; 9000]).unwrap();
    let error = open(dir.path(), false).await.unwrap_err();
    assert_eq!(error.kind(), Kind::Precondition);
    assert!(error.message().contains("cannot be used") && error.message().contains("rebuild"), "{error}");
}

#[tokio::test]
async fn a_truncated_database_is_refused() {
    let dir = used().await;
    let path = data_folder::database(dir.path());
    let whole = fs::read(&path).unwrap();
    for bytes in [whole.len() / 2, whole.len() - 4096, 5000, 100] {
        fs::write(&path, &whole[..bytes]).unwrap();
        let error = open(dir.path(), false).await.unwrap_err();
        assert_eq!(error.kind(), Kind::Precondition, "{bytes}: {error}");
        assert!(error.message().contains("rebuild --data-dir"), "{bytes}: {error}");
    }
}

/// The copy is taken while the server runs, without the write-ahead log that has the recording.
#[tokio::test]
async fn a_copy_without_its_write_ahead_log_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let store = open(dir.path(), false).await.unwrap();
    store.close().await;
    let store = open(dir.path(), false).await.unwrap();
    record(&store, dir.path(), b"in the log").await;
    let copy = fs::read(data_folder::database(dir.path())).unwrap();
    store.close().await;
    for suffix in ["-wal", "-shm"] {
        let _ = fs::remove_file(beside_database(dir.path(), suffix));
    }
    fs::write(data_folder::database(dir.path()), copy).unwrap();
    refused(dir.path(), "older than the blobs").await;
}

#[tokio::test]
async fn an_older_database_put_back_is_refused() {
    let dir = used().await;
    let older = fs::read(data_folder::database(dir.path())).unwrap();
    let store = open(dir.path(), false).await.unwrap();
    record(&store, dir.path(), b"second").await;
    store.close().await;
    fs::write(data_folder::database(dir.path()), older).unwrap();
    refused(dir.path(), "older than the blobs").await;
}

#[tokio::test]
async fn the_database_of_another_folder_is_refused() {
    let (dir, other) = (used().await, used().await);
    fs::copy(data_folder::database(other.path()), data_folder::database(dir.path())).unwrap();
    refused(dir.path(), "another folder").await;
}

#[tokio::test]
async fn unmounted_blobs_are_detected() {
    let dir = used().await;
    fs::rename(dir.path().join("blobs"), dir.path().join("elsewhere")).unwrap();
    refused(dir.path(), "not mounted").await;
}

#[tokio::test]
async fn a_crash_before_the_first_stamp_is_accepted() {
    let dir = tempfile::tempdir().unwrap();
    Blobs::open(dir.path()).unwrap();
    Store::open(&data_folder::database(dir.path())).await.unwrap().close().await;
    let store = open(dir.path(), false).await.unwrap();
    let stamp = Stamp::read(dir.path()).unwrap().unwrap();
    // A crash between the stamp and its record in the database.
    testing::run(&store, "update lab set stamped = 0, generation = generation + 1").await;
    store.close().await;
    open(dir.path(), false).await.unwrap();
    assert_eq!(Stamp::read(dir.path()).unwrap().unwrap().folder, stamp.folder);
}

#[tokio::test]
async fn no_write_is_acknowledged_once_the_database_is_deleted() {
    let dir = tempfile::tempdir().unwrap();
    let store = open(dir.path(), false).await.unwrap();
    let task = testing::task(&store).await;
    fs::remove_file(data_folder::database(dir.path())).unwrap();
    let error = store.insert_upload(&testing::upload(&task, b"late"), None).await.unwrap_err();
    assert_eq!(error.kind(), Kind::Precondition);
    assert!(error.message().contains("was deleted"), "{error}");
    assert!(store.lost().is_cancelled());
    let saved = dir.path().join("saved.db");
    store.copy_to(&saved).await.unwrap();
    store.close().await;
    fs::rename(saved, data_folder::database(dir.path())).unwrap();
    for suffix in ["-wal", "-shm"] {
        let _ = fs::remove_file(beside_database(dir.path(), suffix));
    }
    let store = open(dir.path(), false).await.unwrap();
    assert_eq!(store.task(&task.spec.name).await.unwrap().id, task.id, "acknowledged data was saved");
}

/// An older copy under the newer log, which SQLite would merge without an error.
#[tokio::test]
async fn an_older_database_under_a_newer_log_is_refused_and_left_as_it_is() {
    let dir = used().await;
    let path = data_folder::database(dir.path());
    let older = fs::read(&path).unwrap();
    let store = open(dir.path(), false).await.unwrap();
    for number in 0..200_u8 {
        record(&store, dir.path(), &[number; 9]).await;
    }
    let log = fs::read(beside_database(dir.path(), "-wal")).unwrap();
    store.close().await;
    fs::write(&path, &older).unwrap();
    fs::write(beside_database(dir.path(), "-wal"), &log[..log.len() / 2]).unwrap();
    let error = open(dir.path(), false).await.unwrap_err();
    assert_eq!(error.kind(), Kind::Precondition, "{error}");
    assert_eq!(fs::read(&path).unwrap(), older, "the file is unchanged");
}

#[tokio::test]
async fn a_stamp_that_a_crash_left_empty_is_made_again_before_the_first_one_counts() {
    let dir = tempfile::tempdir().unwrap();
    Blobs::open(dir.path()).unwrap();
    Store::open(&data_folder::database(dir.path())).await.unwrap().close().await;
    fs::write(data_folder::stamp::path(dir.path()), b"").unwrap();
    open(dir.path(), false).await.unwrap().close().await;
    fs::write(data_folder::stamp::path(dir.path()), b"").unwrap();
    assert!(open(dir.path(), false).await.is_err(), "from then on an unreadable stamp is refused");
}

/// The cluster runs the job of the first server. A server on the copy that resumed it would cancel it once it is silent.
#[tokio::test]
async fn a_copy_does_not_watch_the_jobs_of_a_cluster() {
    let dir = tempfile::tempdir().unwrap();
    let store = open(dir.path(), false).await.unwrap();
    let attempt = testing::claimed(&store, &testing::task(&store).await.id, "slurm").await;
    testing::run(&store, "update jobs set engine_id = '7', process = 'one', cancel_requested = true").await;
    let engines = async |store: &Store| {
        let running = store.running_attempts().await.unwrap().into_iter();
        running.map(|left| (left.attempt, left.placement.engine, left.bound)).collect::<Vec<_>>()
    };
    assert_eq!(engines(&store).await, [(attempt.clone(), "slurm".to_owned(), true)]);
    let copied = dir.path().join("copied.db");
    Store::copy(&data_folder::database(dir.path()), &copied).await.unwrap();
    let copy = Store::open(&copied).await.unwrap();
    assert_eq!(engines(&copy).await, [(attempt, String::new(), false)], "the next server ends it, as its own children");
}
