//! Files of another user and read-only files. Root has access to all files, so the server starts without that capability.

use std::{
    fs,
    os::unix::fs::{PermissionsExt as _, chown},
    path::Path,
    process::Command,
};

use crate::support::{
    api::Api,
    data_folder::{UsedFolder, start_by, swept},
    files,
    skipped::skipped,
};

/// Starts a program that has no access to files of other users although root runs it.
const WITHOUT_CAPABILITIES: [&str; 2] = ["setpriv", "--bounding-set=-dac_override,-dac_read_search,-fowner,-chown"];
const OTHER: u32 = 65534;

/// Whether this machine supports files of another user and the start of a program without capabilities.
fn is_supported(folder: &Path) -> bool {
    let file = folder.join("of-another");
    fs::write(&file, "").unwrap();
    fs::set_permissions(&file, fs::Permissions::from_mode(0o600)).unwrap();
    let changed = chown(&file, Some(OTHER), Some(OTHER)).is_ok();
    let output = Command::new(WITHOUT_CAPABILITIES[0]).arg(WITHOUT_CAPABILITIES[1]).arg("cat").arg(&file).output();
    fs::remove_file(&file).unwrap();
    let supported =
        changed && output.is_ok_and(|output| String::from_utf8_lossy(&output.stderr).contains("Permission"));
    if !supported {
        skipped("files cannot change their owner here, so no test had files of another user");
    }
    supported
}

/// A file or folder of another user, its mode, and a part of the error.
const CASES: [(&str, u32, &str); 4] = [
    ("", 0o700, "Permission denied"),
    ("gleaner.db", 0o600, "chown -R"),
    ("gleaner.db", 0o644, "cannot be opened to read and write"),
    ("blobs", 0o700, "Permission denied"),
];

#[tokio::test]
async fn files_of_another_user_stop_the_start_with_the_reason_and_lose_nothing() {
    for (name, mode, words) in CASES {
        let lab = UsedFolder::copy().await;
        if !is_supported(lab.path()) {
            return;
        }
        lab.backdate();
        let path = lab.path().join(name);
        let before = fs::metadata(&path).unwrap().permissions();
        chown(&path, Some(OTHER), Some(OTHER)).unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(mode)).unwrap();
        let (started, text) = start_by(&WITHOUT_CAPABILITIES.map(str::to_owned), lab.path(), &[]).await;
        assert!(!started && text.contains(words), "{name} {mode:o}: {text}");
        lab.expect_all_recordings();
        chown(&path, Some(0), Some(0)).unwrap();
        fs::set_permissions(&path, before).unwrap();
        let server = swept(lab.path(), &["--workers", "0"]).await;
        assert_eq!(Api::connect(&server).await.episode_ids().await, lab.ids(), "{name} {mode:o}");
        lab.expect_all_recordings();
    }
}

/// The server starts, and its sweep stops instead of removing the rows of blobs that it cannot read.
#[tokio::test]
async fn unreadable_folder_of_blobs_loses_nothing() {
    let lab = UsedFolder::copy().await;
    if !is_supported(lab.path()) {
        return;
    }
    lab.backdate();
    let folders = files::blob_folders(lab.path());
    for folder in &folders {
        chown(folder, Some(OTHER), Some(OTHER)).unwrap();
        fs::set_permissions(folder, fs::Permissions::from_mode(0o700)).unwrap();
    }
    let (started, text) = start_by(&WITHOUT_CAPABILITIES.map(str::to_owned), lab.path(), &["--trash-days", "0"]).await;
    assert!(started, "{text}");
    lab.expect_all_recordings();
    for folder in &folders {
        chown(folder, Some(0), Some(0)).unwrap();
    }
    let server = swept(lab.path(), &["--workers", "0", "--trash-days", "0"]).await;
    assert_eq!(Api::connect(&server).await.episode_ids().await, lab.ids());
    lab.expect_all_recordings();
}
