//! Backups are complete, restorable, and survive interruptions.

mod serving;

use std::{fs, path::PathBuf};

use super::{
    super::{
        backup::backup,
        manifest::Manifest,
        restore::{expect_replaceable, restore},
    },
    *,
};
use crate::{
    config::{BackupConfig, DatabaseConfig, RestoreConfig},
    error::{Kind, Result},
};

struct Backups {
    dir: TempDir,
}

impl Backups {
    fn new() -> Self {
        Self { dir: tempfile::tempdir().unwrap() }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }
}

async fn back_up(lab: &Lab, target: &Path, prune: bool) -> Result<(bool, String)> {
    back_up_folder(lab.dir.path(), target, prune).await
}

async fn back_up_folder(data_dir: &Path, target: &Path, prune: bool) -> Result<(bool, String)> {
    let config = BackupConfig {
        target: target.to_owned(),
        data_dir: data_dir.to_owned(),
        verify: false,
        prune,
        database: DatabaseConfig::default(),
    };
    let mut out = Vec::new();
    let sound = backup(&config, &mut out).await?;
    Ok((sound, String::from_utf8(out).unwrap()))
}

async fn restore_to(from: &Path, to: &Path) -> Result<bool> {
    let database = DatabaseConfig::default();
    restore(&RestoreConfig { backup: from.to_owned(), data_dir: to.to_owned(), database }, &mut Vec::new()).await
}

#[tokio::test]
async fn a_restored_folder_equals_the_backed_up_one() {
    let (lab, folders) = (lab().await, Backups::new());
    let (target, new) = (folders.path("backup"), folders.path("lab/new"));
    let upload = testing::upload(&lab.task, b"open");
    lab.store.insert_upload(&upload, None).await.unwrap();
    let (sound, summary) = back_up(&lab, &target, false).await.unwrap();
    assert!(sound && summary.contains("3 blobs of 21 bytes, 3 of them new"), "{summary}");
    let report = checked(&target, false).await;
    assert!(report.sound && report.findings.is_empty(), "a backup can be checked: {:?}", report.findings);

    // Data added after the backup is not part of it.
    testing::episode(&lab.store, &lab.task, Outcome::Success, "").await;
    assert!(restore_to(&target, &new).await.unwrap());
    let report = checked(&new, false).await;
    assert!(report.sound && report.findings.is_empty() && report.blobs == 3, "{:?}", report.findings);
    let restored = Store::open(&new.join("gleaner.db")).await.unwrap();
    assert_eq!(restored.outcome_counts(&lab.task.id).await.unwrap().success, 1);
    assert!(restored.uploads().await.unwrap().is_empty(), "their bytes are not backed up");
    assert_eq!(Blobs::open(&new).unwrap().get(&lab.recording).unwrap(), b"failure");
}

#[tokio::test]
async fn the_second_backup_copies_new_blobs_and_prunes_on_request() {
    let (lab, folders) = (lab().await, Backups::new());
    let target = folders.path("backup");
    back_up(&lab, &target, false).await.unwrap();
    let first = Manifest::read(&target).unwrap().unwrap();
    let before = fs::metadata(Blobs::at(&target).unwrap().path(&lab.recording)).unwrap().modified().unwrap();
    let upload = crate::domain::episode::Upload { outcome: Outcome::Failure, ..testing::upload(&lab.task, b"new") };
    lab.blobs.put(b"new").unwrap();
    lab.store.finish_upload(&upload, &testing::inspected(&lab.task, &upload)).await.unwrap();
    let (_, summary) = back_up(&lab, &target, false).await.unwrap();
    assert!(summary.contains("4 blobs of 24 bytes, 1 of them new"), "{summary}");
    assert_eq!(fs::metadata(Blobs::at(&target).unwrap().path(&lab.recording)).unwrap().modified().unwrap(), before);
    assert_ne!(Manifest::read(&target).unwrap().unwrap().database, first.database);

    let orphan = Blobs::at(&target).unwrap().put(b"of an earlier database").unwrap();
    back_up(&lab, &target, false).await.unwrap();
    assert!(Blobs::at(&target).unwrap().contains(&orphan));
    let (_, summary) = back_up(&lab, &target, true).await.unwrap();
    assert!(summary.contains("1 removed") && !Blobs::at(&target).unwrap().contains(&orphan), "{summary}");
    assert!(checked(&target, false).await.findings.is_empty());
}

/// The state after a kill: the draft of the database exists, and some blobs.
#[tokio::test]
async fn an_interrupted_backup_leaves_the_earlier_one() {
    let (lab, folders) = (lab().await, Backups::new());
    let target = folders.path("backup");
    back_up(&lab, &target, false).await.unwrap();
    testing::episode(&lab.store, &lab.task, Outcome::Success, "its blob was not copied").await;
    fs::create_dir_all(target.join("tmp")).unwrap();
    Store::copy(&lab.dir.path().join("gleaner.db"), &target.join("tmp/gleaner.db")).await.unwrap();
    Blobs::at(&target).unwrap().put(b"copied before the interruption").unwrap();
    assert!(restore_to(&target, &folders.path("new")).await.unwrap());
    let restored = Store::open(&folders.path("new/gleaner.db")).await.unwrap();
    assert_eq!(restored.outcome_counts(&lab.task.id).await.unwrap().success, 1);
    // A first backup that was interrupted cannot be restored.
    let begun = folders.path("begun");
    fs::create_dir_all(&begun).unwrap();
    fs::write(begun.join("BACKUP"), "").unwrap();
    assert_eq!(restore_to(&begun, &folders.path("other")).await.unwrap_err().kind(), Kind::Precondition);
    assert!(!folders.path("other").exists());
    assert!(back_up(&lab, &begun, false).await.is_ok(), "the next one resumes");
}

#[tokio::test]
async fn missing_blobs_are_reported_and_the_rest_is_backed_up_and_restored() {
    let (lab, folders) = (lab().await, Backups::new());
    let target = folders.path("backup");
    fs::write(lab.blobs.path(&lab.checkpoint), b"encodes").unwrap();
    let (sound, summary) = back_up(&lab, &target, false).await.unwrap();
    assert!(!sound && summary.contains(lab.checkpoint.as_str()) && summary.contains("pol_"), "{summary}");
    assert!(!restore_to(&target, &folders.path("new")).await.unwrap());
    assert_eq!(Blobs::at(&folders.path("new")).unwrap().get(&lab.recording).unwrap(), b"failure");
    // Once repaired, the next backup is complete.
    lab.blobs.put(b"encoder").unwrap();
    assert!(back_up(&lab, &target, false).await.unwrap().0);
}

#[tokio::test]
async fn a_damaged_backup_is_detected() {
    let (lab, folders) = (lab().await, Backups::new());
    let target = folders.path("backup");
    back_up(&lab, &target, false).await.unwrap();
    fs::write(Blobs::at(&target).unwrap().path(&lab.recording), b"failurf").unwrap();
    let report = checked(&target, false).await;
    assert!(report.findings[0].subject.contains(lab.recording.as_str()), "{:?}", report.findings);
    assert!(!restore_to(&target, &folders.path("new")).await.unwrap());
    let verify = BackupConfig {
        target: target.clone(),
        data_dir: lab.dir.path().to_owned(),
        verify: true,
        prune: false,
        database: DatabaseConfig::default(),
    };
    assert!(backup(&verify, &mut Vec::new()).await.unwrap());
    assert!(checked(&target, false).await.sound, "it was copied again");
    let mut database = fs::read(target.join("gleaner.db")).unwrap();
    let last = database.len() - 1;
    database[last] ^= 1;
    fs::write(target.join("gleaner.db"), database).unwrap();
    let error = restore_to(&target, &folders.path("newer")).await.unwrap_err();
    assert!(error.message().contains("manifest"), "{error}");
    let check = CheckConfig { data_dir: target.clone(), fast: false, json: false, database: DatabaseConfig::default() };
    // The last page may have rows, or the schema, without which there is no report.
    match check_folder(&check).await {
        Ok(report) => assert!(!report.sound),
        Err(error) => assert!(error.kind() == Kind::Precondition && error.message().contains("is damaged"), "{error}"),
    }
}

#[tokio::test]
async fn other_data_is_never_overwritten() {
    let (lab, folders) = (lab().await, Backups::new());
    let (target, full) = (folders.path("backup"), folders.path("full"));
    back_up(&lab, &target, false).await.unwrap();
    fs::create_dir_all(&full).unwrap();
    fs::write(full.join("thesis.txt"), "mine").unwrap();
    for error in [
        restore_to(&target, &full).await.unwrap_err(),
        back_up(&lab, &full, false).await.unwrap_err(),
        back_up(&lab, &lab.dir.path().join("in the middle"), false).await.unwrap_err(),
        restore_to(&full, &folders.path("new")).await.unwrap_err(),
    ] {
        assert_eq!(error.kind(), Kind::Precondition, "{error}");
    }
    assert_eq!(fs::read_dir(&full).unwrap().count(), 1);
    let held = crate::lock::DataLock::take(&target).unwrap();
    assert_eq!(
        back_up(&lab, &target, false).await.unwrap_err().kind(),
        Kind::Precondition,
        "another backup is running"
    );
    drop(held);
    // An empty folder is accepted.
    fs::create_dir_all(folders.path("empty")).unwrap();
    assert!(restore_to(&target, &folders.path("empty")).await.unwrap());
}

/// A mounted disk is refused by the system as a folder with content is: at the rename.
#[tokio::test]
async fn a_folder_that_cannot_be_replaced_is_refused_before_the_copy() {
    let (lab, folders) = (lab().await, Backups::new());
    let (target, place) = (folders.path("backup"), folders.path("place"));
    fs::create_dir_all(place.join("content")).unwrap();
    let error = expect_replaceable(folders.dir.path(), &place).unwrap_err();
    assert!(error.kind() == Kind::Precondition && error.message().contains("/place/lab"), "{error}");
    fs::remove_dir(place.join("content")).unwrap();
    back_up(&lab, &target, false).await.unwrap();
    assert!(restore_to(&target, &place).await.unwrap(), "an empty folder is replaced");
    let mut names: Vec<_> = fs::read_dir(folders.dir.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    names.sort();
    assert_eq!(names, ["backup", "place"], "no draft is left");
}

/// A new and empty lab is what a server makes where the disk of its data folder is not mounted.
#[tokio::test]
async fn the_backup_of_another_lab_is_not_replaced() {
    let (lab, folders) = (lab().await, Backups::new());
    let (target, new) = (folders.path("backup"), folders.path("new"));
    back_up(&lab, &target, false).await.unwrap();
    let earlier = Manifest::read(&target).unwrap().unwrap();
    let (other, store) = testing::sqlite().await;
    let task = testing::task(&store).await;
    for content in [b"success".as_slice(), b"of another lab"] {
        let error = back_up_folder(other.path(), &target, true).await.unwrap_err();
        assert!(error.kind() == Kind::Precondition && error.message().contains("of its 3 blobs"), "{error}");
        // One recording of the two labs is the same.
        let upload = testing::upload(&task, content);
        Blobs::open(other.path()).unwrap().put(content).unwrap();
        store.finish_upload(&upload, &testing::inspected(&task, &upload)).await.unwrap();
    }
    assert!(back_up_folder(other.path(), &target, true).await.is_err());
    assert_eq!(Manifest::read(&target).unwrap().unwrap(), earlier);
    assert!(checked(&target, false).await.sound);
    // A restored lab has another name and the same blobs.
    assert!(restore_to(&target, &new).await.unwrap());
    assert!(back_up_folder(&new, &target, true).await.unwrap().0);
}

#[tokio::test]
async fn a_lab_that_keeps_few_blobs_is_known_by_the_name_of_its_folder() {
    let (lab, folders) = (lab().await, Backups::new());
    let (target, database) = (folders.path("backup"), crate::store::Database::in_folder(lab.dir.path()));
    // As the first start of a server.
    Store::open_with_blobs(&database, &lab.blobs, false).await.unwrap().close().await;
    back_up(&lab, &target, false).await.unwrap();
    let (manifest, blobs) = (Manifest::read(&target).unwrap().unwrap(), Blobs::open(&target).unwrap());
    (0..9_u8).for_each(|number| drop(blobs.put(&[number]).unwrap()));
    Manifest { blobs: 12, folder: Some("of another".to_owned()), ..manifest.clone() }.write(&target).unwrap();
    let error = back_up(&lab, &target, true).await.unwrap_err();
    assert!(error.message().contains("names only 3 of its 12 blobs"), "{error}");
    Manifest { blobs: 12, ..manifest }.write(&target).unwrap();
    assert!(back_up(&lab, &target, true).await.unwrap().1.contains("9 removed"));
}

/// The server refuses to start on such a folder; the nightly backup must not copy it either.
#[tokio::test]
async fn a_database_that_is_older_than_its_blobs_replaces_no_backup() {
    let (lab, folders) = (lab().await, Backups::new());
    let (target, path) = (folders.path("backup"), lab.dir.path().join("gleaner.db"));
    lab.store.clone().close().await;
    let older = fs::read(&path).unwrap();
    let database = crate::store::Database::in_folder(lab.dir.path());
    Store::open_with_blobs(&database, &lab.blobs, false).await.unwrap().close().await;
    back_up(&lab, &target, false).await.unwrap();
    let earlier = Manifest::read(&target).unwrap().unwrap();
    fs::write(&path, older).unwrap();
    let error = back_up(&lab, &target, true).await.unwrap_err();
    assert!(error.kind() == Kind::Precondition && error.message().contains("older than the blobs"), "{error}");
    assert_eq!(Manifest::read(&target).unwrap().unwrap(), earlier);
    assert!(checked(&target, false).await.sound);
}
