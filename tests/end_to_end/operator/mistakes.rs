//! Mistakes beside a server that does not run: each stops the start, and each has a way out that loses nothing.

use std::{fs, path::Path};

use super::{
    folder::{Folder, refused, start, swept},
    ids,
};
use crate::{api::Api, maintenance::command};

/// Deletes the files that belong to a database.
fn without_companions(data: &Path) {
    for suffix in ["-wal", "-shm"] {
        let _ = fs::remove_file(data.join(format!("gleaner.db{suffix}")));
    }
}

/// What an operator does by mistake.
type Mistake = (&'static str, fn(&Folder));

const MISTAKES: [Mistake; 8] = [
    ("the database is deleted with its companions", |lab| {
        fs::remove_file(lab.path().join("gleaner.db")).unwrap();
        without_companions(lab.path());
    }),
    ("the database is deleted and its log is left", |lab| fs::remove_file(lab.path().join("gleaner.db")).unwrap()),
    ("the database is emptied", |lab| {
        fs::write(lab.path().join("gleaner.db"), "").unwrap();
        without_companions(lab.path());
    }),
    ("the database is cut in half", |lab| {
        let path = lab.path().join("gleaner.db");
        let bytes = fs::read(&path).unwrap();
        fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
        without_companions(lab.path());
    }),
    ("the database is overwritten", |lab| {
        fs::write(lab.path().join("gleaner.db"), vec![7; 100_000]).unwrap();
        without_companions(lab.path());
    }),
    ("the database was copied without its log", |lab| without_companions(lab.path())),
    ("an older database is put back", |lab| {
        without_companions(lab.path());
        fs::copy(lab.older(), lab.path().join("gleaner.db")).unwrap();
    }),
    ("the stamp is deleted", |lab| fs::remove_file(lab.path().join("blobs/stamp.json")).unwrap()),
];

#[tokio::test]
async fn each_mistake_stops_the_start_and_a_rebuild_brings_every_recording_back() {
    for (what, mistake) in MISTAKES {
        let lab = Folder::used().await;
        lab.backdate();
        mistake(&lab);
        refused(lab.path()).await;
        refused(lab.path()).await;
        lab.nothing_is_lost();
        let (_, text) = command(&["rebuild"], lab.path()).await;
        assert!(text.contains("rebuilt"), "{what}: {text}");
        for _ in 0..2 {
            let server = swept(lab.path(), &["--workers", "0"]).await;
            assert_eq!(ids(&mut Api::connect(&server).await).await, lab.ids(), "{what}: {text}");
            lab.nothing_is_lost();
        }
        let (sound, text) = command(&["check"], lab.path()).await;
        assert!(sound, "{what}: {text}");
    }
}

/// The third way out is a person's act, and costs no recording either.
#[tokio::test]
async fn an_accepted_database_moves_recordings_to_the_trash_and_no_sweep_deletes_them() {
    for (what, mistake) in [MISTAKES[0], MISTAKES[6]] {
        let lab = Folder::used().await;
        lab.backdate();
        mistake(&lab);
        let (started, text) = start(lab.path(), &["--accept-database"]).await;
        assert!(started && text.contains("accepted by --accept-database"), "{what}: {text}");
        // More recordings than any share allows, over again, with a trash that keeps nothing.
        for _ in 0..3 {
            let flags = ["--workers", "0", "--max-sweep-share", "1", "--trash-days", "0"];
            drop(swept(lab.path(), &flags).await);
            lab.nothing_is_lost();
        }
        let (_, text) = command(&["rebuild"], lab.path()).await;
        assert!(text.contains("taken back from the trash"), "{what}: {text}");
        let server = swept(lab.path(), &["--workers", "0"]).await;
        assert_eq!(ids(&mut Api::connect(&server).await).await, lab.ids(), "{what}: {text}");
        lab.nothing_is_lost();
    }
}

#[tokio::test]
async fn the_database_of_another_lab_is_refused_and_set_aside() {
    let (lab, other) = (Folder::used().await, tempfile::tempdir().unwrap());
    drop(swept(other.path(), &["--workers", "0"]).await);
    without_companions(lab.path());
    fs::copy(other.path().join("gleaner.db"), lab.path().join("gleaner.db")).unwrap();
    lab.backdate();
    refused(lab.path()).await;
    let (_, text) = command(&["rebuild"], lab.path()).await;
    assert!(text.contains("the previous database is now"), "{text}");
    let server = swept(lab.path(), &["--workers", "0"]).await;
    assert_eq!(ids(&mut Api::connect(&server).await).await, lab.ids());
    lab.nothing_is_lost();
}

/// Folders beside the database: what is derived is made again, and nothing acknowledged was in it.
#[tokio::test]
async fn folders_of_derived_files_may_go_and_their_return_out_of_order_harms_nothing() {
    let lab = Folder::used().await;
    for folder in ["cache", "tmp", "uploads", "logs", "rollouts", "blobs/tasks"] {
        let _ = fs::remove_dir_all(lab.path().join(folder));
    }
    lab.backdate();
    let server = swept(lab.path(), &["--workers", "0"]).await;
    let mut api = Api::connect(&server).await;
    assert_eq!(ids(&mut api).await, lab.ids());
    crate::lab::push(&mut api, crate::lab::TASK, &crate::lab::RECORDINGS[9]).await.unwrap();
    lab.nothing_is_lost();
}

#[tokio::test]
async fn removed_sidecars_are_written_again() {
    let lab = Folder::used().await;
    let sidecars = || -> Vec<_> {
        let folders = fs::read_dir(lab.path().join("blobs")).unwrap().map(|entry| entry.unwrap().path());
        let hex = folders.filter(|path| path.is_dir() && path.file_name().is_some_and(|name| name.len() == 2));
        let files = hex.flat_map(|folder| fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()));
        files.filter(|path| path.extension().is_some_and(|extension| extension == "json")).collect()
    };
    assert_eq!(sidecars().len(), lab.ids().len());
    for sidecar in sidecars() {
        fs::remove_file(sidecar).unwrap();
    }
    let _server = swept(lab.path(), &["--workers", "0"]).await;
    let written = async {
        while sidecars().len() < lab.ids().len() {
            tokio::task::yield_now().await;
        }
    };
    tokio::time::timeout(std::time::Duration::from_secs(60), written).await.expect("sidecars cannot be written");
}

/// The database is newer than the blobs: a lab's blobs restored out of order.
#[tokio::test]
async fn older_blobs_put_back_lose_nothing_and_the_newer_ones_return() {
    let lab = Folder::used().await;
    let (blobs, aside) = (lab.path().join("blobs"), lab.path().join("aside"));
    lab.backdate();
    fs::rename(&blobs, &aside).unwrap();
    fs::rename(lab.older_blobs(), &blobs).unwrap();
    for _ in 0..2 {
        drop(swept(lab.path(), &["--workers", "0", "--trash-days", "0"]).await);
        for digest in lab.older_digests() {
            lab.is_there(digest);
        }
    }
    let (sound, text) = command(&["check"], lab.path()).await;
    assert!(!sound && text.matches("is not there").count() == 2, "{text}");
    fs::remove_dir_all(&blobs).unwrap();
    fs::rename(&aside, &blobs).unwrap();
    let server = swept(lab.path(), &["--workers", "0", "--trash-days", "0"]).await;
    assert_eq!(ids(&mut Api::connect(&server).await).await, lab.ids());
    lab.nothing_is_lost();
    assert!(command(&["check"], lab.path()).await.0);
}

/// Not `restore`, but the backup's database copied over the lab's.
#[tokio::test]
async fn the_database_of_a_backup_copied_in_is_refused_and_completed() {
    let lab = Folder::used().await;
    let place = tempfile::tempdir().unwrap();
    let backup = place.path().join("backup");
    let mut server = swept(lab.path(), &["--workers", "0"]).await;
    assert!(command(&["backup", backup.to_str().unwrap()], lab.path()).await.0);
    let newest = crate::lab::push(&mut Api::connect(&server).await, crate::lab::TASK, &crate::lab::RECORDINGS[9]).await;
    let newest = newest.unwrap();
    assert!(server.stop().await);
    lab.backdate();
    fs::copy(backup.join("gleaner.db"), lab.path().join("gleaner.db")).unwrap();
    refused(lab.path()).await;
    let (_, text) = command(&["rebuild"], lab.path()).await;
    assert!(text.contains("and 1 episodes"), "{text}");
    let server = swept(lab.path(), &["--workers", "0"]).await;
    let found = ids(&mut Api::connect(&server).await).await;
    assert!(found.contains(&newest.id) && found.len() == lab.ids().len() + 1, "{found:?}");
    lab.nothing_is_lost();
    lab.is_there(&newest.blake3);
}
