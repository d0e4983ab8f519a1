//! A data folder that a server has used, what was acknowledged of it, and ways to start a server that may refuse.

use std::{
    fs,
    path::{Path, PathBuf},
    process::{Command, Stdio},
    time::{Duration, SystemTime},
};

use tempfile::TempDir;
use tokio::{
    io::{AsyncBufReadExt as _, AsyncReadExt as _, BufReader},
    sync::OnceCell,
};

use crate::{
    api::Api,
    lab::{self, RECORDINGS},
    server::TestServer,
};

const DAY: Duration = Duration::from_secs(24 * 60 * 60);

/// Used once, then copied for each test.
static USED: OnceCell<Used> = OnceCell::const_new();

struct Used {
    dir: TempDir,
    acknowledged: Vec<(String, String)>,
}

/// A copy of a used data folder.
pub struct Folder {
    path: PathBuf,
    /// Removed with the copy.
    _dir: TempDir,
    acknowledged: Vec<(String, String)>,
}

impl Folder {
    /// A folder with eight recordings: six from before `older.db` was copied, and two from after it that are in the
    /// write-ahead log only, because the server was killed.
    pub async fn used() -> Self {
        let used = USED.get_or_init(use_folder).await;
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("lab");
        copy(used.dir.path(), &path);
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

    /// The digests of the first recordings, those that `older_blobs` has.
    pub fn older_digests(&self) -> Vec<&str> {
        self.acknowledged[..6].iter().map(|(_, digest)| digest.as_str()).collect()
    }

    /// The ids of the acknowledged episodes, sorted.
    pub fn ids(&self) -> Vec<String> {
        let mut ids: Vec<String> = self.acknowledged.iter().map(|(id, _)| id.clone()).collect();
        ids.sort();
        ids
    }

    /// Has every file look four days old, so that a sweep takes none of them for new.
    pub fn backdate(&self) {
        backdate(&self.path().join("blobs"));
    }

    /// Every acknowledged recording is in the folder with its content.
    pub fn nothing_is_lost(&self) {
        self.nothing_is_lost_in(&self.path);
    }

    pub fn nothing_is_lost_in(&self, folder: &Path) {
        for (id, digest) in &self.acknowledged {
            assert!(find(folder, digest), "the recording of {id} is gone");
        }
    }

    pub fn is_there(&self, digest: &str) {
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
            copy(&dir.path().join("blobs"), &dir.path().join("older-blobs"));
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
pub fn copy(from: &Path, to: &Path) {
    let copied = Command::new("cp").arg("-a").arg(from).arg(to).status().unwrap();
    assert!(copied.success());
}

fn backdate(folder: &Path) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            backdate(&path);
        } else {
            fs::File::open(&path).unwrap().set_modified(SystemTime::now() - DAY * 4).unwrap();
        }
    }
}

/// Whether a blob is among the blobs, in their trash, or set aside by a rebuild.
fn find(folder: &Path, digest: &str) -> bool {
    let place = Path::new(&digest[..2]).join(&digest[2..]);
    let places = [
        folder.join("blobs").join(&place),
        folder.join("blobs/trash").join(&place),
        folder.join(format!("unclaimed/{digest}.mcap")),
    ];
    places.iter().any(|place| fs::read(place).is_ok_and(|bytes| blake3::hash(&bytes).to_hex().as_str() == digest))
}

/// Starts a server that may refuse; whether it served, and its log until it served or ended.
pub async fn start(data: &Path, flags: &[&str]) -> (bool, String) {
    start_by(&[], data, flags).await
}

/// As [`start`], by a program that starts others.
pub async fn start_by(starter: &[&str], data: &Path, flags: &[&str]) -> (bool, String) {
    let mut words = starter.iter().copied().chain([env!("CARGO_BIN_EXE_gleaner-server-under-test")]);
    let mut child = tokio::process::Command::new(words.next().unwrap())
        .args(words)
        .args(["serve", "--listen", "127.0.0.1:0", "--workers", "0", "--drain-seconds", "1", "--data-dir"])
        .arg(data)
        .args(flags)
        .env("GLEANER_LOG", "warn")
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .kill_on_drop(true)
        .spawn()
        .unwrap();
    let mut listening = String::new();
    let mut out = BufReader::new(child.stdout.take().unwrap());
    // A refusal ends the process; a server that starts serves its health.
    let mut errors = child.stderr.take().unwrap();
    out.read_line(&mut listening).await.unwrap();
    let answers = async {
        let Some(url) = listening.trim().strip_prefix("listening on ") else { return false };
        let Ok(channel) = tonic::transport::Endpoint::from_shared(url.to_owned()).unwrap().connect().await else {
            return false;
        };
        let request = tonic_health::pb::HealthCheckRequest::default();
        tonic_health::pb::health_client::HealthClient::new(channel).check(request).await.is_ok()
    };
    let started = tokio::select! {
        started = answers => started,
        _ = child.wait() => false,
    };
    if started {
        child.start_kill().unwrap();
    }
    // One that refuses ends by itself, once it has given the reason.
    child.wait().await.unwrap();
    let mut text = String::new();
    errors.read_to_string(&mut text).await.unwrap();
    (started, text)
}

/// A start is refused, with the ways out; gives what the server wrote.
pub async fn refused(data: &Path) -> String {
    let (started, text) = start(data, &[]).await;
    assert!(!started, "it started: {text}");
    for way in ["Nothing was changed", "restore BACKUP", "rebuild --data-dir"] {
        assert!(text.contains(way), "{way}: {text}");
    }
    text
}

/// A server whose first sweep is over, or was refused.
pub async fn swept(data: &Path, flags: &[&str]) -> TestServer {
    let bait = data.join("logs/bait.log");
    fs::create_dir_all(data.join("logs")).unwrap();
    fs::write(&bait, "an old log").unwrap();
    fs::File::open(&bait).unwrap().set_modified(SystemTime::now() - DAY * 400).unwrap();
    let server = TestServer::start_over(data, flags).await;
    let gone = async {
        while bait.exists() {
            tokio::task::yield_now().await;
        }
    };
    tokio::time::timeout(Duration::from_secs(60), gone).await.expect("the sweep takes too long");
    server
}
