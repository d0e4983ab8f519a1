//! A disk that is really full: a small file system of its own, filled to the last block. Needs the right to mount one.

use std::{
    fs::File,
    io::Write as _,
    path::{Path, PathBuf},
    process::Command,
};

use gleaner_proto::v1::*;
use tempfile::TempDir;
use tonic::Code;

use crate::{
    api::Api,
    lab::{self, RECORDINGS},
    maintenance::command,
    server::TestServer,
    skipped::skipped,
};

/// A small file system in memory; gone when it is dropped.
pub struct SmallDisk(TempDir);

impl SmallDisk {
    /// `None`, loudly, where nothing may be mounted.
    pub fn mount(mebibytes: u32) -> Option<Self> {
        let folder = tempfile::tempdir().unwrap();
        let size = format!("size={mebibytes}m");
        let mount = Command::new("mount").args(["-t", "tmpfs", "-o", &size, "tmpfs"]).arg(folder.path()).output();
        match mount {
            Ok(done) if done.status.success() => Some(Self(folder)),
            refused => {
                skipped(&format!("nothing may be mounted here, so no disk was full: {refused:?}"));
                None
            }
        }
    }

    /// A data folder on it.
    pub fn data(&self) -> PathBuf {
        self.0.path().join("data")
    }

    /// Has nothing be written on it any more, or again; false where that is not allowed.
    pub fn set_read_only(&self, read_only: bool) -> bool {
        let way = if read_only { "remount,ro" } else { "remount,rw" };
        Command::new("mount").args(["-o", way]).arg(self.0.path()).status().is_ok_and(|status| status.success())
    }

    /// Takes what is left; what is taken is given back by removing the file.
    fn fill(&self) -> PathBuf {
        let path = self.0.path().join("ballast");
        let mut file = File::create(&path).unwrap();
        for block in [vec![7; 1 << 20], vec![7; 4096], vec![7; 1]] {
            while file.write_all(&block).is_ok() {}
        }
        path
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        let unmounted = Command::new("umount").arg("-l").arg(self.0.path()).status();
        assert!(unmounted.is_ok_and(|status| status.success()), "the small disk stays at {:?}", self.0.path());
    }
}

pub async fn label(api: &mut Api, id: &str) -> Result<(), tonic::Status> {
    let request = LabelEpisodesRequest {
        episode_ids: vec![id.to_owned()],
        outcome: Outcome::Unknown.into(),
        reason: "r".repeat(200),
        ..Default::default()
    };
    api.episodes.label_episodes(request).await.map(|_| ())
}

/// Until it is refused, as what is on hand of the database's log may be used up first.
pub async fn refused(api: &mut Api, id: &str) -> tonic::Status {
    for _ in 0..5000 {
        if let Err(status) = label(api, id).await {
            return status;
        }
    }
    panic!("a full disk took 5000 labels");
}

pub async fn sound(data_dir: &Path) {
    let (sound, said) = command(&["check"], data_dir).await;
    assert!(sound, "{said}");
}

#[tokio::test]
async fn a_full_disk_refuses_writes_until_there_is_room_and_loses_nothing() {
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
    assert!(status.code() == Code::ResourceExhausted && status.message().contains("disk is full"), "{status}");
    let status = lab::write(&mut api, &upload, committed, RECORDINGS[7].bytes.slice(half..)).await.unwrap_err();
    assert!(status.code() == Code::ResourceExhausted && status.message().contains("disk is full"), "{status}");
    let status = refused(&mut api, &episode.id).await;
    assert!(status.code() == Code::ResourceExhausted && status.message().contains("disk is full"), "{status}");

    // What only reads goes on.
    let request = ListEpisodesRequest { task: lab::TASK.into(), ..Default::default() };
    let before = api.episodes.list_episodes(request.clone()).await.unwrap().into_inner().episodes;
    assert_eq!(before.len(), 1);
    let download = DownloadEpisodeRequest { episode_id: episode.id.clone() };
    let mut chunks = api.episodes.download_episode(download).await.unwrap().into_inner();
    assert!(chunks.message().await.unwrap().is_some());
    sound(&disk.data()).await;

    std::fs::remove_file(ballast).unwrap();
    label(&mut api, &episode.id).await.unwrap();
    let committed = api.episodes.get_upload(GetUploadRequest { upload_id: upload.clone() }).await.unwrap().into_inner();
    let rest = usize::try_from(committed.committed_size).unwrap();
    lab::write(&mut api, &upload, committed.committed_size, RECORDINGS[7].bytes.slice(rest..)).await.unwrap();
    lab::finish(&mut api, &upload).await.unwrap();
    lab::finish(&mut api, &whole).await.unwrap();
    assert_eq!(api.episodes.list_episodes(request).await.unwrap().into_inner().episodes.len(), 3);
    sound(&disk.data()).await;

    // It starts and stops on a full disk, too: nothing that was acknowledged is gone.
    let _ballast = disk.fill();
    server.kill().await;
    sound(&disk.data()).await;
}

/// Neither the death of its worker nor that of the server ends it, nor can they be written down; it ends all the same once
/// there is room.
#[tokio::test]
async fn a_job_outlasts_a_full_disk() {
    let Some(disk) = SmallDisk::mount(128) else { return };
    let mut server = TestServer::start_over(&disk.data(), &["--min-free-bytes", "0"]).await;
    let mut api = Api::connect(&server).await;
    let episodes = lab::set_up(&mut api).await;
    let job = api.submit(lab::TASK, lab::pretrain(60)).await.unwrap();
    api.watch_until(&job.id, |job| job.done > 5).await;
    let ballast = disk.fill();
    refused(&mut api, &episodes[0].id).await;
    for worker in server.workers() {
        let worker = rustix::process::Pid::from_raw(i32::try_from(worker).unwrap()).unwrap();
        rustix::process::kill_process(worker, rustix::process::Signal::KILL).unwrap();
    }
    server.kill().await;
    server.start_again().await;
    let mut api = Api::connect(&server).await;
    let request = GetJobRequest { job_id: job.id.clone() };
    let waiting = api.jobs.get_job(request).await.unwrap().into_inner().job.unwrap();
    assert!(matches!(waiting.state(), JobState::Running | JobState::Queued), "{waiting:?}");
    std::fs::remove_file(ballast).unwrap();
    let ended = api.watch(&job.id).await;
    assert_eq!((ended.state(), ended.attempt), (JobState::Succeeded, 1), "{}", ended.error);
    sound(&disk.data()).await;
}

#[tokio::test]
async fn a_mark_keeps_room_for_the_database() {
    let Some(disk) = SmallDisk::mount(32) else { return };
    let mark = (8 << 20).to_string();
    let server = TestServer::start_over(&disk.data(), &["--workers", "0", "--min-free-bytes", &mark]).await;
    let mut api = Api::connect(&server).await;
    lab::create_task(&mut api).await;
    let episode = lab::push(&mut api, lab::TASK, &RECORDINGS[0]).await.unwrap();
    let ballast = disk.0.path().join("ballast");
    std::fs::write(&ballast, vec![7; 26 << 20]).unwrap();
    let status = lab::start(&mut api, lab::TASK, &RECORDINGS[7]).await.unwrap_err();
    assert!(status.code() == Code::ResourceExhausted && status.message().contains("--min-free-bytes"), "{status}");
    for _ in 0..50 {
        label(&mut api, &episode.id).await.unwrap();
    }
    std::fs::remove_file(ballast).unwrap();
    lab::push(&mut api, lab::TASK, &RECORDINGS[7]).await.unwrap();
    sound(server.data_dir()).await;
}
