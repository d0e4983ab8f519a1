//! A data folder that a server has used, the recordings that were acknowledged in it, and starts of servers that may fail.

use std::{
    fs,
    path::{Path, PathBuf},
    process::{Command, Stdio},
};

use tempfile::TempDir;
use tokio::{
    io::{AsyncBufReadExt as _, AsyncReadExt as _, BufReader},
    sync::OnceCell,
};

use super::{
    api::Api,
    files::{self, backdate},
    lab::{self, RECORDINGS},
    server::{TestServer, serve_by},
    wait::until,
};

/// Made once and copied for each test.
static USED: OnceCell<Used> = OnceCell::const_new();

struct Used {
    dir: TempDir,
    acknowledged: Vec<(String, String)>,
}

/// A copy of a used data folder.
pub struct UsedFolder {
    path: PathBuf,
    /// Removed with the copy.
    _dir: TempDir,
    acknowledged: Vec<(String, String)>,
}

impl UsedFolder {
    /// A folder with eight recordings: six from before `older.db` was copied, and two after it that are in the write-ahead
    /// log only, because the server was killed.
    pub async fn copy() -> Self {
        let used = USED.get_or_init(use_folder).await;
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("lab");
        copy_folder(used.dir.path(), &path);
        Self { path, _dir: dir, acknowledged: used.acknowledged.clone() }
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    /// A copy of the database from before the last two recordings.
    pub fn older(&self) -> PathBuf {
        self.path().join("older.db")
    }

    /// A copy of the blobs from before the last two recordings.
    pub fn older_blobs(&self) -> PathBuf {
        self.path.join("older-blobs")
    }

    /// The digests of the recordings in `older_blobs`.
    pub fn older_digests(&self) -> Vec<&str> {
        self.acknowledged[..6].iter().map(|(_, digest)| digest.as_str()).collect()
    }

    /// The ids of the acknowledged episodes, sorted.
    pub fn ids(&self) -> Vec<String> {
        let mut ids: Vec<String> = self.acknowledged.iter().map(|(id, _)| id.clone()).collect();
        ids.sort();
        ids
    }

    /// Makes every blob four days old, so that sweeps do not skip it as new.
    pub fn backdate(&self) {
        for file in files::files(&self.path.join("blobs")) {
            backdate(&file, 4);
        }
    }

    /// Checks that the folder has every acknowledged recording with its content.
    pub fn expect_all_recordings(&self) {
        self.expect_all_recordings_in(&self.path);
    }

    pub fn expect_all_recordings_in(&self, folder: &Path) {
        for (id, digest) in &self.acknowledged {
            assert!(find(folder, digest), "the recording of {id} is gone");
        }
    }

    pub fn expect_recording(&self, digest: &str) {
        assert!(find(&self.path, digest), "a recording is gone");
    }
}

async fn use_folder() -> Used {
    let dir = tempfile::tempdir().unwrap();
    let mut server = TestServer::start_over(dir.path(), &["--workers", "0"]).await;
    let mut api = Api::connect(&server).await;
    lab::create_task(&mut api).await;
    let mut acknowledged = Vec::new();
    for recording in &RECORDINGS[..8] {
        if acknowledged.len() == 6 {
            assert!(server.stop().await);
            fs::copy(dir.path().join("gleaner.db"), dir.path().join("older.db")).unwrap();
            copy_folder(&dir.path().join("blobs"), &dir.path().join("older-blobs"));
            server.start_again().await;
            api = Api::connect(&server).await;
        }
        let episode = lab::push(&mut api, lab::TASK, recording).await.unwrap();
        acknowledged.push((episode.id, episode.blake3));
    }
    server.kill().await;
    Used { dir, acknowledged }
}

/// Copies a folder with everything in it.
pub fn copy_folder(from: &Path, to: &Path) {
    let copied = Command::new("cp").arg("-a").arg(from).arg(to).status().unwrap();
    assert!(copied.success());
}

/// Whether a blob is among the blobs, in their trash, or set aside by a rebuild.
fn find(folder: &Path, digest: &str) -> bool {
    let trash = folder.join("blobs/trash").join(&digest[..2]).join(&digest[2..]);
    let places = [files::blob(folder, digest), trash, folder.join(format!("unclaimed/{digest}.mcap"))];
    places.iter().any(|place| fs::read(place).is_ok_and(|bytes| blake3::hash(&bytes).to_hex().as_str() == digest))
}

/// Starts a server that may fail; returns whether it served, and its log until it served or ended.
pub async fn start(data: &Path, flags: &[&str]) -> (bool, String) {
    start_by(&[], data, flags).await
}

/// Like [`start`], by a program that starts the server.
pub async fn start_by(starter: &[String], data: &Path, flags: &[&str]) -> (bool, String) {
    let flags = [&["--workers", "0", "--drain-seconds", "1"], flags].concat();
    let mut command = serve_by(starter, data, &flags, "127.0.0.1:0");
    let mut child = command.env("GLEANER_LOG", "warn").stderr(Stdio::piped()).spawn().unwrap();
    let mut listening = String::new();
    let mut out = BufReader::new(child.stdout.take().unwrap());
    let mut errors = child.stderr.take().unwrap();
    out.read_line(&mut listening).await.unwrap();
    // A server that has started responds to a health check; one that fails ends.
    let healthy = async {
        let Some(url) = listening.trim().strip_prefix("listening on ") else { return false };
        let Ok(channel) = tonic::transport::Endpoint::from_shared(url.to_owned()).unwrap().connect().await else {
            return false;
        };
        let request = tonic_health::pb::HealthCheckRequest::default();
        tonic_health::pb::health_client::HealthClient::new(channel).check(request).await.is_ok()
    };
    let started = tokio::select! {
        started = healthy => started,
        _ = child.wait() => false,
    };
    if started {
        child.start_kill().unwrap();
    }
    child.wait().await.unwrap();
    let mut text = String::new();
    errors.read_to_string(&mut text).await.unwrap();
    (started, text)
}

/// Checks that a start fails with the ways out; returns the log of the server.
pub async fn expect_rejected(data: &Path) -> String {
    let (started, text) = start(data, &[]).await;
    assert!(!started, "it started: {text}");
    for way in ["The data folder is unchanged", "restore BACKUP", "rebuild --data-dir"] {
        assert!(text.contains(way), "{way}: {text}");
    }
    text
}

/// Starts a server; returns once its first sweep has handled rows and blobs.
pub async fn swept(data: &Path, flags: &[&str]) -> TestServer {
    // A sweep removes old logs after rows and blobs.
    let log = data.join("logs/old.log");
    fs::create_dir_all(data.join("logs")).unwrap();
    fs::write(&log, "an old log").unwrap();
    backdate(&log, 400);
    let server = TestServer::start_over(data, flags).await;
    until("the sweep ends", async || (!log.exists()).then_some(())).await;
    server
}
