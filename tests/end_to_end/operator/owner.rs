//! Files of another user, and files that may not be written. Root may do everything, so the server gives up that right.

use std::{
    fs,
    os::unix::fs::{PermissionsExt as _, chown},
    path::Path,
    process::Command,
};

use super::{
    folder::{Folder, start_by, swept},
    ids,
};
use crate::{api::Api, skipped::skipped};

/// Starts a program that obeys the owners and modes of files although root runs it.
const OBEDIENT: [&str; 2] = ["setpriv", "--bounding-set=-dac_override,-dac_read_search,-fowner,-chown"];
const OTHER: u32 = 65534;

/// Whether files can be given to another user here, and a program be started that obeys that.
fn can_be_tried(folder: &Path) -> bool {
    let file = folder.join("of-another");
    fs::write(&file, "").unwrap();
    fs::set_permissions(&file, fs::Permissions::from_mode(0o600)).unwrap();
    let given = chown(&file, Some(OTHER), Some(OTHER)).is_ok();
    let refused = Command::new(OBEDIENT[0]).arg(OBEDIENT[1]).arg("cat").arg(&file).output();
    fs::remove_file(&file).unwrap();
    let tried = given && refused.is_ok_and(|output| String::from_utf8_lossy(&output.stderr).contains("Permission"));
    if !tried {
        skipped("files cannot be given to another user here, so none was another's");
    }
    tried
}

/// What is another's, with its mode, and what the server does: refuses the start with these words, or starts.
const CASES: [(&str, u32, Option<&str>); 4] = [
    ("", 0o700, Some("Permission denied")),
    ("gleaner.db", 0o600, Some("chown -R")),
    ("gleaner.db", 0o644, Some("cannot be opened to read and write")),
    ("blobs", 0o700, Some("Permission denied")),
];

#[tokio::test]
async fn files_of_another_user_stop_the_start_with_the_reason_and_lose_nothing() {
    for (name, mode, words) in CASES {
        let lab = Folder::used().await;
        if !can_be_tried(lab.path()) {
            return;
        }
        lab.backdate();
        let path = lab.path().join(name);
        let before = fs::metadata(&path).unwrap().permissions();
        chown(&path, Some(OTHER), Some(OTHER)).unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(mode)).unwrap();
        let (started, text) = start_by(&OBEDIENT, lab.path(), &[]).await;
        assert!(!started && words.is_some_and(|words| text.contains(words)), "{name} {mode:o}: {text}");
        lab.nothing_is_lost();
        chown(&path, Some(0), Some(0)).unwrap();
        fs::set_permissions(&path, before).unwrap();
        let server = swept(lab.path(), &["--workers", "0"]).await;
        assert_eq!(ids(&mut Api::connect(&server).await).await, lab.ids(), "{name} {mode:o}");
        lab.nothing_is_lost();
    }
}

/// A folder within the blobs: the server starts, and its sweep breaks off rather than take what it cannot see for gone.
#[tokio::test]
async fn a_folder_of_blobs_that_cannot_be_read_loses_nothing() {
    let lab = Folder::used().await;
    if !can_be_tried(lab.path()) {
        return;
    }
    lab.backdate();
    let folders: Vec<_> = fs::read_dir(lab.path().join("blobs"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.file_name().unwrap().len() == 2)
        .collect();
    for folder in &folders {
        chown(folder, Some(OTHER), Some(OTHER)).unwrap();
        fs::set_permissions(folder, fs::Permissions::from_mode(0o700)).unwrap();
    }
    let (started, text) = start_by(&OBEDIENT, lab.path(), &["--trash-days", "0"]).await;
    assert!(started, "{text}");
    lab.nothing_is_lost();
    for folder in &folders {
        chown(folder, Some(0), Some(0)).unwrap();
    }
    let server = swept(lab.path(), &["--workers", "0", "--trash-days", "0"]).await;
    assert_eq!(ids(&mut Api::connect(&server).await).await, lab.ids());
    lab.nothing_is_lost();
}
