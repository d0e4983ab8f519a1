//! Operator faults: files of a data folder are deleted, replaced, truncated, copied in part, moved and restored out of order,
//! with starts and sweeps in between. An acknowledged recording is removed only after a person has deleted it and the days
//! of the trash have passed.

mod clock;
mod mistakes;
mod owner;
mod running;

use std::path::Path;

use crate::support::{
    api::Api,
    command::{expect_sound, server_text},
    data_folder::{UsedFolder, copy_folder, expect_rejected, start, swept},
    disk::SmallDisk,
    files,
    lab::{self, RECORDINGS},
    server::TestServer,
    skipped::skipped,
};

/// The files and folders of a data folder that other users may access.
fn open_to_others(folder: &Path) -> Vec<String> {
    use std::os::unix::fs::PermissionsExt as _;
    // Not those that a running server is about to rename.
    let paths = files::tree(folder, |name| !files::is_draft(name)).into_iter().chain([folder.to_owned()]);
    let modes = paths.map(|path| (std::fs::symlink_metadata(&path).unwrap().permissions().mode() & 0o777, path));
    let open = modes.filter(|(mode, _)| mode & 0o077 != 0);
    open.map(|(mode, path)| format!("{}: {mode:04o}", path.display())).collect()
}

#[tokio::test]
async fn files_are_readable_by_their_owner_only() {
    let place = tempfile::tempdir().unwrap();
    let (data, backup) = (place.path().join("lab"), place.path().join("backup"));
    let (mut server, mut api, _) = lab::over(&data).await;
    api.succeed(lab::TASK, lab::pretrain(2)).await;
    assert!(server_text(&["backup", backup.to_str().unwrap()], &data).await.0);
    assert_eq!(open_to_others(&data), Vec::<String>::new());
    assert_eq!(open_to_others(&backup), Vec::<String>::new());
    assert!(server.stop().await);
    assert_eq!(open_to_others(&data), Vec::<String>::new());
}

#[tokio::test]
async fn blobs_on_another_disk_are_used() {
    let Some(disk) = SmallDisk::mount(64) else { return };
    let lab = UsedFolder::copy().await;
    let (blobs, there) = (lab.path().join("blobs"), disk.data());
    let moved = std::process::Command::new("mv").arg(&blobs).arg(&there).status().unwrap();
    assert!(moved.success());
    std::os::unix::fs::symlink(&there, &blobs).unwrap();
    let server = TestServer::start_over(lab.path(), &["--workers", "0"]).await;
    let mut api = Api::connect(&server).await;
    assert_eq!(api.episode_ids().await, lab.ids());
    lab::push(&mut api, lab::TASK, &RECORDINGS[9]).await.unwrap();
    let episode = lab::push(&mut api, lab::TASK, &RECORDINGS[10]).await.unwrap();
    drop(server);
    lab.backdate();
    let _server = swept(lab.path(), &["--workers", "0"]).await;
    lab.expect_all_recordings();
    lab.expect_recording(&episode.blake3);
    expect_sound(lab.path()).await;
}

/// The folder of the blobs exists and is empty.
#[tokio::test]
async fn unmounted_disk_of_blobs_stops_the_start() {
    let lab = UsedFolder::copy().await;
    let (blobs, aside) = (lab.path().join("blobs"), lab.path().join("aside"));
    std::fs::rename(&blobs, &aside).unwrap();
    std::fs::create_dir(&blobs).unwrap();
    let text = expect_rejected(lab.path()).await;
    assert!(text.contains("not mounted"), "{text}");
    std::fs::remove_dir_all(&blobs).unwrap();
    std::fs::rename(&aside, &blobs).unwrap();
    let server = swept(lab.path(), &["--workers", "0"]).await;
    assert_eq!(Api::connect(&server).await.episode_ids().await, lab.ids());
    lab.expect_all_recordings();
}

#[tokio::test]
async fn read_only_data_folder_stops_the_start() {
    let Some(disk) = SmallDisk::mount(64) else { return };
    let lab = UsedFolder::copy().await;
    copy_folder(lab.path(), &disk.data());
    if !disk.set_read_only(true) {
        return skipped("a disk cannot be mounted again here, so none was read-only");
    }
    let (started, text) = start(&disk.data(), &[]).await;
    assert!(!started && text.contains("Read-only") && text.contains("--data-dir"), "{text}");
    assert!(disk.set_read_only(false));
    let server = swept(&disk.data(), &["--workers", "0"]).await;
    assert_eq!(Api::connect(&server).await.episode_ids().await, lab.ids());
    lab.expect_all_recordings_in(&disk.data());
}

/// A backup beside a sweep restores to a sound folder, whichever of them ends first.
#[tokio::test]
async fn backup_during_a_sweep_is_complete() {
    let lab = UsedFolder::copy().await;
    let mut server = TestServer::start_over(lab.path(), &["--workers", "0", "--trash-days", "0"]).await;
    let mut api = Api::connect(&server).await;
    let deleted: Vec<String> = lab.ids().into_iter().take(2).collect();
    for id in &deleted {
        api.delete(id).await;
    }
    server.stop().await;
    let places = tempfile::tempdir().unwrap();
    for number in 0..3 {
        let (backup, new) = (places.path().join(format!("b{number}")), places.path().join(format!("n{number}")));
        let words = ["backup", backup.to_str().unwrap()];
        let (_, (sound, text)) = tokio::join!(server.start_again(), server_text(&words, lab.path()));
        assert!(sound, "{text}");
        server.kill().await;
        let (sound, text) = server_text(&["restore", backup.to_str().unwrap()], &new).await;
        assert!(sound, "{text}");
        let restored = swept(&new, &["--workers", "0"]).await;
        let left = Api::connect(&restored).await.episode_ids().await;
        assert!(lab.ids().iter().all(|id| left.contains(id) || deleted.contains(id)), "{left:?}");
    }
}
