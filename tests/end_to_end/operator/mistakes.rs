//! Mistakes while the server is stopped: each stops the start, and a rebuild or a restore loses no recording.

use std::{fs, path::Path};

use crate::support::{
    api::Api,
    command::{expect_sound, server_text},
    data_folder::{UsedFolder, expect_rejected, start, swept},
    files, lab,
    wait::until,
};

/// Deletes the write-ahead log of a database and its index.
fn remove_log(data: &Path) {
    for suffix in ["-wal", "-shm"] {
        let _ = fs::remove_file(data.join(format!("gleaner.db{suffix}")));
    }
}

/// A description of a mistake, and its effect on a folder.
type Mistake = (&'static str, fn(&UsedFolder));

const MISTAKES: [Mistake; 8] = [
    ("the database is deleted with its log", |lab| {
        fs::remove_file(lab.path().join("gleaner.db")).unwrap();
        remove_log(lab.path());
    }),
    ("the database is deleted without its log", |lab| fs::remove_file(lab.path().join("gleaner.db")).unwrap()),
    ("the database is emptied", |lab| {
        fs::write(lab.path().join("gleaner.db"), "").unwrap();
        remove_log(lab.path());
    }),
    ("the database is cut in half", |lab| {
        let path = lab.path().join("gleaner.db");
        let bytes = fs::read(&path).unwrap();
        fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
        remove_log(lab.path());
    }),
    ("the database is overwritten", |lab| {
        fs::write(lab.path().join("gleaner.db"), vec![7; 100_000]).unwrap();
        remove_log(lab.path());
    }),
    ("the database was copied without its log", |lab| remove_log(lab.path())),
    ("an older database is restored", |lab| {
        remove_log(lab.path());
        fs::copy(lab.older(), lab.path().join("gleaner.db")).unwrap();
    }),
    ("the stamp is deleted", |lab| fs::remove_file(lab.path().join("blobs/stamp.json")).unwrap()),
];

#[tokio::test]
async fn each_mistake_stops_the_start_and_rebuild_restores_every_recording() {
    for (what, mistake) in MISTAKES {
        let lab = UsedFolder::copy().await;
        lab.backdate();
        mistake(&lab);
        expect_rejected(lab.path()).await;
        expect_rejected(lab.path()).await;
        lab.expect_all_recordings();
        let (_, text) = server_text(&["rebuild"], lab.path()).await;
        assert!(text.contains("rebuilt"), "{what}: {text}");
        for _ in 0..2 {
            let server = swept(lab.path(), &["--workers", "0"]).await;
            assert_eq!(Api::connect(&server).await.episode_ids().await, lab.ids(), "{what}: {text}");
            lab.expect_all_recordings();
        }
        let (sound, text) = server_text(&["check"], lab.path()).await;
        assert!(sound, "{what}: {text}");
    }
}

/// `--accept-database` loses no recording either.
#[tokio::test]
async fn sweeps_delete_no_recording_that_an_accepted_database_lacks() {
    for (what, mistake) in [MISTAKES[0], MISTAKES[6]] {
        let lab = UsedFolder::copy().await;
        lab.backdate();
        mistake(&lab);
        let (started, text) = start(lab.path(), &["--accept-database"]).await;
        assert!(started && text.contains("accepted by --accept-database"), "{what}: {text}");
        // Several sweeps with the largest share and no days in the trash.
        for _ in 0..3 {
            let flags = ["--workers", "0", "--max-sweep-share", "1", "--trash-days", "0"];
            drop(swept(lab.path(), &flags).await);
            lab.expect_all_recordings();
        }
        let (_, text) = server_text(&["rebuild"], lab.path()).await;
        assert!(text.contains("restored from the trash"), "{what}: {text}");
        let server = swept(lab.path(), &["--workers", "0"]).await;
        assert_eq!(Api::connect(&server).await.episode_ids().await, lab.ids(), "{what}: {text}");
        lab.expect_all_recordings();
    }
}

#[tokio::test]
async fn database_of_another_lab_is_rejected_and_set_aside() {
    let (lab, other) = (UsedFolder::copy().await, tempfile::tempdir().unwrap());
    drop(swept(other.path(), &["--workers", "0"]).await);
    remove_log(lab.path());
    fs::copy(other.path().join("gleaner.db"), lab.path().join("gleaner.db")).unwrap();
    lab.backdate();
    expect_rejected(lab.path()).await;
    let (_, text) = server_text(&["rebuild"], lab.path()).await;
    assert!(text.contains("the previous database is now"), "{text}");
    let server = swept(lab.path(), &["--workers", "0"]).await;
    assert_eq!(Api::connect(&server).await.episode_ids().await, lab.ids());
    lab.expect_all_recordings();
}

/// Derived files are made again; they are not acknowledged data.
#[tokio::test]
async fn missing_folders_of_derived_files_lose_nothing() {
    let lab = UsedFolder::copy().await;
    for folder in ["cache", "tmp", "uploads", "logs", "rollouts", "blobs/tasks"] {
        let _ = fs::remove_dir_all(lab.path().join(folder));
    }
    lab.backdate();
    let server = swept(lab.path(), &["--workers", "0"]).await;
    let mut api = Api::connect(&server).await;
    assert_eq!(api.episode_ids().await, lab.ids());
    lab::push(&mut api, lab::TASK, &lab::RECORDINGS[9]).await.unwrap();
    lab.expect_all_recordings();
}

#[tokio::test]
async fn removed_sidecars_are_written_again() {
    let lab = UsedFolder::copy().await;
    let sidecars = || -> Vec<_> {
        let files = files::blob_folders(lab.path()).into_iter().flat_map(|folder| files::files(&folder));
        files.filter(|path| path.extension().is_some_and(|extension| extension == "json")).collect()
    };
    assert_eq!(sidecars().len(), lab.ids().len());
    for sidecar in sidecars() {
        fs::remove_file(sidecar).unwrap();
    }
    let _server = swept(lab.path(), &["--workers", "0"]).await;
    until("the sidecars are written", async || (sidecars().len() >= lab.ids().len()).then_some(())).await;
}

/// The blobs are older than the database.
#[tokio::test]
async fn older_blobs_under_a_newer_database_lose_nothing() {
    let lab = UsedFolder::copy().await;
    let (blobs, aside) = (lab.path().join("blobs"), lab.path().join("aside"));
    lab.backdate();
    fs::rename(&blobs, &aside).unwrap();
    fs::rename(lab.older_blobs(), &blobs).unwrap();
    for _ in 0..2 {
        drop(swept(lab.path(), &["--workers", "0", "--trash-days", "0"]).await);
        for digest in lab.older_digests() {
            lab.expect_recording(digest);
        }
    }
    let (sound, text) = server_text(&["check"], lab.path()).await;
    assert!(!sound && text.matches("is not there").count() == 2, "{text}");
    fs::remove_dir_all(&blobs).unwrap();
    fs::rename(&aside, &blobs).unwrap();
    let server = swept(lab.path(), &["--workers", "0", "--trash-days", "0"]).await;
    assert_eq!(Api::connect(&server).await.episode_ids().await, lab.ids());
    lab.expect_all_recordings();
    expect_sound(lab.path()).await;
}

/// The database of a backup is copied over the current one, without `restore`.
#[tokio::test]
async fn database_copied_from_a_backup_is_rejected_and_completed() {
    let lab = UsedFolder::copy().await;
    let place = tempfile::tempdir().unwrap();
    let backup = place.path().join("backup");
    let mut server = swept(lab.path(), &["--workers", "0"]).await;
    assert!(server_text(&["backup", backup.to_str().unwrap()], lab.path()).await.0);
    let newest = lab::push(&mut Api::connect(&server).await, lab::TASK, &lab::RECORDINGS[9]).await;
    let newest = newest.unwrap();
    assert!(server.stop().await);
    lab.backdate();
    fs::copy(backup.join("gleaner.db"), lab.path().join("gleaner.db")).unwrap();
    expect_rejected(lab.path()).await;
    let (_, text) = server_text(&["rebuild"], lab.path()).await;
    assert!(text.contains("and 1 episodes"), "{text}");
    let server = swept(lab.path(), &["--workers", "0"]).await;
    let found = Api::connect(&server).await.episode_ids().await;
    assert!(found.contains(&newest.id) && found.len() == lab.ids().len() + 1, "{found:?}");
    lab.expect_all_recordings();
    lab.expect_recording(&newest.blake3);
}
