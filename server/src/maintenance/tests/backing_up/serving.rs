//! A backup that a server uses as its data folder.

use super::*;
use crate::{config::RebuildConfig, maintenance::rebuild::rebuild, store::Database};

/// A person in a hurry starts the server on the backup itself.
#[tokio::test]
async fn a_backup_is_no_data_folder_unless_it_is_accepted_as_one() {
    let (lab, folders) = (lab().await, Backups::new());
    let target = folders.path("backup");
    back_up(&lab, &target, false).await.unwrap();
    let (blobs, database) = (Blobs::open(&target).unwrap(), Database::in_folder(&target));
    let config = RebuildConfig { data_dir: target.clone(), fast: true, database: DatabaseConfig::default() };
    let started = Store::open_with_blobs(&database, &blobs, false).await.unwrap_err();
    assert!(started.message().contains("--accept-database"), "{started}");
    let rebuilt = rebuild(&config, &mut Vec::new()).await.unwrap_err();
    for error in [started, rebuilt] {
        assert_eq!(error.kind(), Kind::Precondition, "{error}");
        for part in ["is a backup", "restore", "--data-dir NEW"] {
            assert!(error.message().contains(part), "{part}: {error}");
        }
    }
    assert!(back_up(&lab, &target, false).await.unwrap().0, "the backup is as it was");
    assert!(checked(&target, false).await.findings.is_empty());
    // A restored folder is a data folder at once, and an accepted backup from then on.
    assert!(restore_to(&target, &folders.path("new")).await.unwrap());
    for (folder, accept) in [(folders.path("new"), false), (target.clone(), true), (target, false)] {
        let database = Database::in_folder(&folder);
        Store::open_with_blobs(&database, &Blobs::open(&folder).unwrap(), accept).await.unwrap().close().await;
    }
}

/// From then on its recordings may be nowhere else.
#[tokio::test]
async fn a_backup_that_a_server_has_used_is_not_replaced() {
    let (lab, folders) = (lab().await, Backups::new());
    let target = folders.path("backup");
    back_up(&lab, &target, false).await.unwrap();
    let blobs = Blobs::open(&target).unwrap();
    let store = Store::open_with_blobs(&Database::in_folder(&target), &blobs, true).await.unwrap();
    let upload = testing::upload(&lab.task, b"acknowledged there");
    blobs.put(b"acknowledged there").unwrap();
    store.finish_upload(&upload, &testing::inspected(&lab.task, &upload)).await.unwrap();
    store.close().await;
    let database = fs::read(target.join("gleaner.db")).unwrap();
    let error = back_up(&lab, &target, true).await.unwrap_err();
    assert!(error.kind() == Kind::Precondition && error.message().contains("a server has used"), "{error}");
    assert!(fs::read(target.join("gleaner.db")).unwrap() == database && blobs.contains(&upload.blake3));
}
