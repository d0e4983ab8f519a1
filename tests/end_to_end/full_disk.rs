//! A full disk: a small file system that is filled to its last block, where one can be mounted.

use gleaner_proto::v1::*;
use tonic::Code;

use crate::support::{
    api::Api,
    command::{expect_sound, server_text},
    data_folder::UsedFolder,
    disk::{SmallDisk, label, label_until_rejected},
    errors::expect_error,
    files::files,
    lab::{self, RECORDINGS},
    server::TestServer,
    skipped::skipped,
};

fn expect_full(status: &tonic::Status) {
    expect_error(status, Code::ResourceExhausted, &["disk is full", "--data-dir"]);
}

#[tokio::test]
async fn full_disk_rejects_writes_and_loses_nothing() {
    let Some(disk) = SmallDisk::mount(32) else { return };
    let mut server = TestServer::start_over(&disk.data(), &["--workers", "0", "--min-free-bytes", "0"]).await;
    let mut api = Api::connect(&server).await;
    lab::create_task(&mut api).await;
    let episode = lab::push(&mut api, lab::TASK, &RECORDINGS[0]).await.unwrap();
    let upload = lab::start(&mut api, lab::TASK, &RECORDINGS[7]).await.unwrap().upload_id;
    let half = RECORDINGS[7].bytes.len() / 2;
    let committed = lab::write(&mut api, &upload, 0, RECORDINGS[7].bytes.slice(..half)).await.unwrap();

    let whole = lab::start(&mut api, lab::TASK, &RECORDINGS[8]).await.unwrap().upload_id;
    lab::write(&mut api, &whole, 0, RECORDINGS[8].bytes.clone()).await.unwrap();

    let ballast = disk.fill();
    let status = lab::finish(&mut api, &whole).await.unwrap_err();
    expect_full(&status);
    // The decoded steps of the first episode made room for the inspection, in vain.
    disk.fill();
    let status = lab::write(&mut api, &upload, committed, RECORDINGS[7].bytes.slice(half..)).await.unwrap_err();
    expect_full(&status);
    let status = label_until_rejected(&mut api, &episode.id).await;
    expect_full(&status);

    // Reads continue.
    assert_eq!(api.episodes().await.len(), 1);
    assert!(api.download(&episode.id).await == RECORDINGS[0].bytes);
    expect_sound(&disk.data()).await;

    std::fs::remove_file(ballast).unwrap();
    label(&mut api, &episode.id).await.unwrap();
    let committed = api.committed_size(&upload).await.unwrap();
    let rest = usize::try_from(committed).unwrap();
    lab::write(&mut api, &upload, committed, RECORDINGS[7].bytes.slice(rest..)).await.unwrap();
    lab::finish(&mut api, &upload).await.unwrap();
    lab::finish(&mut api, &whole).await.unwrap();
    assert_eq!(api.episodes().await.len(), 3);
    expect_sound(&disk.data()).await;

    // A kill on a full disk loses nothing that was acknowledged.
    let _ballast = disk.fill();
    server.kill().await;
    expect_sound(&disk.data()).await;
}

/// Kills of the worker and of the server do not end the job, and the disk has no space to record them; the job succeeds once
/// there is space.
#[tokio::test]
async fn job_survives_a_full_disk() {
    let Some(disk) = SmallDisk::mount(128) else { return };
    let mut server = TestServer::start_over(&disk.data(), &["--min-free-bytes", "0"]).await;
    let mut api = Api::connect(&server).await;
    let episodes = lab::set_up(&mut api).await;
    let job = api.submit(lab::TASK, lab::pretrain(60)).await.unwrap();
    api.watch_until(&job.id, |job| job.done > 5).await;
    let ballast = disk.fill();
    label_until_rejected(&mut api, &episodes[0].id).await;
    server.kill_workers();
    server.kill().await;
    server.start_again().await;
    let mut api = Api::connect(&server).await;
    let request = GetJobRequest { job_id: job.id.clone() };
    let waiting = api.jobs.get_job(request).await.unwrap().into_inner().job.unwrap();
    assert!(matches!(waiting.state(), JobState::Running | JobState::Queued), "{waiting:?}");
    std::fs::remove_file(ballast).unwrap();
    let ended = api.watch(&job.id).await;
    assert_eq!((ended.state(), ended.attempt), (JobState::Succeeded, 1), "{}", ended.error);
    expect_sound(&disk.data()).await;
}

/// Its disk is not that of the data folder, so the message names the folder of the backup.
#[tokio::test]
async fn backup_to_a_full_or_read_only_disk_names_the_folder_of_the_backup() {
    let Some(disk) = SmallDisk::mount(64) else { return };
    let lab = UsedFolder::copy().await;
    let target = disk.path().join("backup");
    let target = target.to_str().unwrap();
    let expect_named = async || {
        let (made, text) = server_text(&["backup", target], lab.path()).await;
        let named = text.contains(&format!("the disk of the backup {target} is full or cannot be written"));
        assert!(!made && named && !text.contains("--data-dir"), "{text}");
    };
    let ballast = disk.fill();
    expect_named().await;
    std::fs::remove_file(ballast).unwrap();
    if !disk.set_read_only(true) {
        return skipped("a disk cannot be mounted again here, so none was read-only");
    }
    expect_named().await;
    assert!(disk.set_read_only(false));
    let (made, text) = server_text(&["backup", target], lab.path()).await;
    assert!(made && text.contains("backed up to"), "{text}");
}

#[tokio::test]
async fn min_free_bytes_keeps_room_for_the_database() {
    let Some(disk) = SmallDisk::mount(32) else { return };
    let free = (8 << 20).to_string();
    let server = TestServer::start_over(&disk.data(), &["--workers", "0", "--min-free-bytes", &free]).await;
    let mut api = Api::connect(&server).await;
    lab::create_task(&mut api).await;
    let episode = lab::push(&mut api, lab::TASK, &RECORDINGS[0]).await.unwrap();
    let ballast = disk.path().join("ballast");
    std::fs::write(&ballast, vec![7; 26 << 20]).unwrap();
    let status = lab::start(&mut api, lab::TASK, &RECORDINGS[7]).await.unwrap_err();
    assert!(status.code() == Code::ResourceExhausted && status.message().contains("--min-free-bytes"), "{status}");
    for _ in 0..50 {
        label(&mut api, &episode.id).await.unwrap();
    }
    std::fs::remove_file(ballast).unwrap();
    lab::push(&mut api, lab::TASK, &RECORDINGS[7]).await.unwrap();
    expect_sound(server.data_dir()).await;
}

/// Without a limit of the cache, its least recently used files make room for the next recording.
#[tokio::test]
async fn decoded_steps_of_earlier_recordings_make_room_for_the_next() {
    const FREE: u64 = 8 << 20;
    let Some(disk) = SmallDisk::mount(32) else { return };
    let flags = ["--workers", "0", "--min-free-bytes", &FREE.to_string()];
    let server = TestServer::start_over(&disk.data(), &flags).await;
    let mut api = Api::connect(&server).await;
    lab::create_task(&mut api).await;
    let (first, further) = RECORDINGS[..8].split_at(6);
    for recording in first {
        lab::push(&mut api, lab::TASK, recording).await.unwrap();
    }
    let decoded = || files(&disk.data().join("cache")).len();
    let of_six = decoded();
    assert!(of_six >= 6, "{of_six}");
    for recording in further {
        // Half of the recording has room, and nothing of its steps.
        disk.leave(FREE + recording.bytes.len() as u64 / 2);
        let before = decoded();
        lab::push(&mut api, lab::TASK, recording).await.unwrap();
        let after = decoded();
        assert!(after <= before, "{after} files, {before} before");
    }
    assert_eq!(api.episodes().await.len(), 8);
    expect_sound(server.data_dir()).await;
}
