//! The hostile operator: files of a data folder are deleted, replaced, cut, copied without their companions, moved and
//! put back out of order, with every start and sweep in between. What must hold is one sentence: no recording that was
//! acknowledged is ever removed except by a person's act and after the trash's days.

mod clock;
pub mod folder;
mod mistakes;
mod owner;
mod running;

use std::path::Path;

use gleaner_proto::v1::*;

use self::folder::{Folder, swept};
use crate::{
    api::Api,
    full_disk::SmallDisk,
    lab::{self, RECORDINGS},
    maintenance::command,
    server::TestServer,
    skipped::skipped,
};

/// The ids of a task's episodes, sorted.
pub async fn ids(api: &mut Api) -> Vec<String> {
    let request = ListEpisodesRequest { task: lab::TASK.into(), ..Default::default() };
    let listed = api.episodes.list_episodes(request).await.unwrap().into_inner().episodes;
    let mut ids: Vec<String> = listed.into_iter().map(|episode| episode.id).collect();
    ids.sort();
    ids
}

/// Mode bits of everything in a folder that are open to others.
fn open_to_others(folder: &Path) -> Vec<String> {
    use std::os::unix::fs::PermissionsExt as _;
    let mut waiting = vec![folder.to_owned()];
    let mut open = Vec::new();
    while let Some(path) = waiting.pop() {
        let found = std::fs::symlink_metadata(&path).unwrap();
        if found.is_dir() {
            waiting.extend(std::fs::read_dir(&path).unwrap().map(|entry| entry.unwrap().path()));
        }
        let mode = found.permissions().mode() & 0o777;
        if mode & 0o077 != 0 {
            open.push(format!("{}: {mode:04o}", path.display()));
        }
    }
    open
}

#[tokio::test]
async fn only_the_owner_reads_what_a_server_makes() {
    let place = tempfile::tempdir().unwrap();
    let (data, backup) = (place.path().join("lab"), place.path().join("backup"));
    let mut server = TestServer::start_over(&data, &[]).await;
    let mut api = Api::connect(&server).await;
    lab::set_up(&mut api).await;
    api.succeed(lab::TASK, lab::pretrain(2)).await;
    assert!(command(&["backup", backup.to_str().unwrap()], &data).await.0);
    assert_eq!(open_to_others(&data), Vec::<String>::new());
    assert_eq!(open_to_others(&backup), Vec::<String>::new());
    assert!(server.stop().await);
    assert_eq!(open_to_others(&data), Vec::<String>::new());
}

#[tokio::test]
async fn blobs_moved_to_another_disk_go_on_from_there() {
    let Some(disk) = SmallDisk::mount(64) else { return };
    let lab = Folder::used().await;
    let (blobs, there) = (lab.path().join("blobs"), disk.data());
    let moved = std::process::Command::new("mv").arg(&blobs).arg(&there).status().unwrap();
    assert!(moved.success());
    std::os::unix::fs::symlink(&there, &blobs).unwrap();
    let server = TestServer::start_over(lab.path(), &["--workers", "0"]).await;
    let mut api = Api::connect(&server).await;
    assert_eq!(ids(&mut api).await, lab.ids());
    lab::push(&mut api, lab::TASK, &RECORDINGS[9]).await.unwrap();
    let episode = lab::push(&mut api, lab::TASK, &RECORDINGS[10]).await.unwrap();
    drop(server);
    lab.backdate();
    let _server = swept(lab.path(), &["--workers", "0"]).await;
    lab.nothing_is_lost();
    lab.is_there(&episode.blake3);
    let (sound, text) = command(&["check"], lab.path()).await;
    assert!(sound, "{text}");
}

/// The blobs' disk is not mounted: their folder is there and empty.
#[tokio::test]
async fn a_disk_that_is_not_mounted_stops_the_start() {
    let lab = Folder::used().await;
    let (blobs, aside) = (lab.path().join("blobs"), lab.path().join("aside"));
    std::fs::rename(&blobs, &aside).unwrap();
    std::fs::create_dir(&blobs).unwrap();
    let text = folder::refused(lab.path()).await;
    assert!(text.contains("not mounted"), "{text}");
    std::fs::remove_dir_all(&blobs).unwrap();
    std::fs::rename(&aside, &blobs).unwrap();
    let server = swept(lab.path(), &["--workers", "0"]).await;
    assert_eq!(ids(&mut Api::connect(&server).await).await, lab.ids());
    lab.nothing_is_lost();
}

#[tokio::test]
async fn a_folder_on_a_read_only_disk_is_refused_with_the_reason_and_starts_once_it_is_writable() {
    let Some(disk) = SmallDisk::mount(64) else { return };
    let lab = Folder::used().await;
    folder::copy(lab.path(), &disk.data());
    if !disk.set_read_only(true) {
        return skipped("no disk may be mounted again here, so none was read-only");
    }
    let (started, text) = folder::start(&disk.data(), &[]).await;
    assert!(!started && text.contains("Read-only"), "{text}");
    assert!(disk.set_read_only(false));
    let server = swept(&disk.data(), &["--workers", "0"]).await;
    assert_eq!(ids(&mut Api::connect(&server).await).await, lab.ids());
    lab.nothing_is_lost_in(&disk.data());
}

/// A backup is made while sweeps remove what was deleted: it restores to a sound folder whichever is first.
#[tokio::test]
async fn a_backup_beside_a_sweep_is_whole() {
    let lab = Folder::used().await;
    let mut server = TestServer::start_over(lab.path(), &["--workers", "0", "--trash-days", "0"]).await;
    let mut api = Api::connect(&server).await;
    let deleted: Vec<String> = lab.ids().into_iter().take(2).collect();
    let delete = DeleteEpisodesRequest { episode_ids: deleted.clone(), force: false };
    api.episodes.delete_episodes(delete).await.unwrap();
    server.stop().await;
    let places = tempfile::tempdir().unwrap();
    for number in 0..3 {
        let (backup, new) = (places.path().join(format!("b{number}")), places.path().join(format!("n{number}")));
        let (backup_words, again) = ([backup.to_str().unwrap().to_owned()], server.start_again());
        let words = ["backup", &backup_words[0]];
        let (_, (sound, text)) = tokio::join!(again, command(&words, lab.path()));
        assert!(sound, "{text}");
        server.kill().await;
        let (sound, text) = command(&["restore", &backup_words[0]], &new).await;
        assert!(sound, "{text}");
        let restored = swept(&new, &["--workers", "0"]).await;
        let left = ids(&mut Api::connect(&restored).await).await;
        assert!(lab.ids().iter().all(|id| left.contains(id) || deleted.contains(id)), "{left:?}");
    }
}
