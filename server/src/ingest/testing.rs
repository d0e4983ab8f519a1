//! Fixtures for tests of uploads: an ingest over a fresh folder, with real and simulated inspectors.

use std::{
    ffi::OsString,
    io::Cursor,
    path::PathBuf,
    sync::{Arc, atomic::AtomicU64},
};

use clap::{Args as _, FromArgMatches as _, Parser as _};
use futures::stream;
use gleaner_inspector::{Order, apply_limits, inspect};
use gleaner_recording::{EpisodeWriter, StepRef, written_mapping};
use tempfile::TempDir;
use tokio::sync::Semaphore;

use super::{Chunk, Ingest, InspectionPermit, Started};
use crate::{
    blobs::Blobs,
    config::{Cli, Command, ServeConfig},
    domain::{
        client::Client,
        episode::{InspectedEpisode, NewUpload, Outcome, Upload},
        id::UploadId,
        task::Task,
    },
    error::Result,
    store::{Store, testing},
};

/// Simulates an inspector that accepts the recording.
pub(crate) const USABLE: &str = r#"printf '{"usable":{"mapping":"plain","steps":20}}' > "$report"; : > "$frames""#;

/// Simulates one that rejects it, naming the file by our path as the reader does.
pub(super) const REFUSING: &str = r#"printf '{"refused":"%s holds no /joints; record it"}' "$recording" > "$report""#;

/// The misbehaviour of a child of this test binary once its limits are on.
const MISBEHAVIOUR: &str = "GLEANER_TEST_MISBEHAVIOUR";
const ARGUMENTS: &str = "GLEANER_TEST_INSPECT";

pub(crate) struct Fixture {
    pub(crate) dir: TempDir,
    pub(crate) store: Store,
    pub(crate) task: Task,
    pub(crate) ingest: Ingest,
    command: Vec<OsString>,
    pub(crate) config: Arc<ServeConfig>,
}

/// A permit for one recording in memory.
pub(crate) fn room(rooms: &Arc<Semaphore>) -> InspectionPermit {
    InspectionPermit { _folder: None, _place: Arc::clone(rooms).try_acquire_owned().unwrap() }
}

/// An ingest whose inspector is this shell script. It is given `$recording`, `$report` and `$frames`.
pub(crate) async fn playing(script: &str) -> Fixture {
    playing_with(script, &[]).await
}

/// As [`playing`], with further flags of `serve`.
pub(super) async fn playing_with(script: &str, flags: &[&str]) -> Fixture {
    let script = format!(
        r#"while [ $# -gt 1 ]; do case $1 in --recording) recording=$2;; --report) report=$2;; --frames) frames=$2;; esac
        shift 2; done; {script}"#
    );
    fixture(vec!["sh".into(), "-c".into(), script.into(), "sh".into()], flags).await
}

/// An ingest over an existing folder and database.
pub(crate) async fn open_on(dir: &TempDir, store: &Store) -> Ingest {
    open(&serving(dir, &[]), store, &[]).await
}

/// An ingest whose inspector is the real one, in a child of this test binary.
pub(crate) async fn real(misbehaviour: &str, flags: &[&str]) -> Fixture {
    fixture(child(misbehaviour), flags).await
}

/// The command of an inspecting child. Its order is passed in the environment: the test harness reads the flags.
pub(super) fn child(misbehaviour: &str) -> Vec<OsString> {
    let exe = std::env::current_exe().unwrap();
    let script = format!(
        r#"{MISBEHAVIOUR}={misbehaviour} {ARGUMENTS}="$*" exec '{}' --exact ingest::testing::as_inspector --nocapture --test-threads=1"#,
        exe.display()
    );
    vec!["sh".into(), "-c".into(), script.into(), "sh".into()]
}

async fn fixture(command: Vec<OsString>, flags: &[&str]) -> Fixture {
    let (dir, store) = testing::store().await;
    let mut spec = testing::spec();
    spec.mappings.push(written_mapping(&spec));
    let task = store.insert_task(&spec).await.unwrap();
    let config = serving(&dir, flags);
    let ingest = open(&config, &store, &command).await;
    Fixture { dir, store, task, ingest, command, config }
}

fn serving(dir: &TempDir, flags: &[&str]) -> Arc<ServeConfig> {
    let data_dir = dir.path().to_str().unwrap();
    let args = [&["gleaner-server", "serve", "--data-dir", data_dir], flags].concat();
    let Command::Serve(config) = Cli::try_parse_from(args).unwrap().command else { panic!("not serve") };
    Arc::new(*config)
}

async fn open(config: &Arc<ServeConfig>, store: &Store, command: &[OsString]) -> Ingest {
    let blobs = Blobs::open(&config.data_dir).unwrap();
    let mut ingest = Ingest::open(config, store.clone(), blobs).await.unwrap();
    let inspector = Arc::into_inner(ingest.inspector).unwrap();
    ingest.inspector = Arc::new(inspector.with_command(command.to_vec()));
    ingest
}

impl Fixture {
    /// Continues with a disk whose free space is the returned number, with 100 bytes to be kept free.
    pub(crate) fn on_a_small_disk(&mut self) -> Arc<AtomicU64> {
        let free = Arc::new(AtomicU64::new(u64::MAX));
        self.ingest.blobs = self.ingest.blobs.clone().sparing(100).playing(&free);
        free
    }

    /// The folder as after a restart.
    pub(super) async fn reopen(&mut self) {
        self.ingest = open(&self.config, &self.store, &self.command).await;
    }

    pub(super) fn new_upload(&self, content: &[u8]) -> NewUpload {
        NewUpload {
            task_id: self.task.id.clone(),
            file_name: "reach.mcap".into(),
            size_bytes: content.len() as u64,
            blake3: blake3::hash(content).into(),
            outcome: Outcome::Success,
            cohort: "ada".into(),
            author: "tests".into(),
            client: Client::Token("tests".into()),
            summary: None,
        }
    }

    /// Starts an upload that must be open.
    pub(super) async fn start(&self, content: &[u8]) -> Upload {
        match self.ingest.start(self.new_upload(content)).await.unwrap() {
            Started::Open(upload) => upload,
            Started::Existing(episode) => panic!("exists already as {}", episode.id),
        }
    }

    /// Another client's upload of the same content.
    pub(super) async fn beside(&self, upload: &Upload) -> Upload {
        let other = Upload { id: UploadId::new(), ..upload.clone() };
        super::part::create(&self.ingest.part_path(&other.id)).unwrap();
        self.store.insert_upload(&other, None).await.unwrap();
        other
    }

    /// Sends these bytes as one complete stream.
    pub(super) async fn write(&self, id: &UploadId, offset: usize, data: &[u8]) -> Result<u64> {
        self.ingest.write(stream::iter([Ok(chunk(id, offset, data))])).await
    }

    /// Start, write, finish.
    pub(crate) async fn push(&self, content: &[u8]) -> Result<InspectedEpisode> {
        let upload = self.start(content).await;
        self.write(&upload.id, 0, content).await?;
        self.ingest.finish(&upload.id).await
    }

    /// The names of the files in these folders of the data directory, blobs included.
    pub(crate) fn files(&self, folders: &[&str]) -> Vec<PathBuf> {
        let mut waiting: Vec<PathBuf> = folders.iter().map(|folder| self.dir.path().join(folder)).collect();
        let mut files = Vec::new();
        while let Some(path) = waiting.pop() {
            match path.is_dir() {
                true => waiting.extend(std::fs::read_dir(path).unwrap().map(|entry| entry.unwrap().path())),
                false => files.push(path),
            }
        }
        files
    }
}

pub(super) fn chunk(id: &UploadId, offset: usize, data: &[u8]) -> Chunk {
    Chunk { upload_id: Some(id.clone()), offset: offset as u64, data: data.to_vec().into() }
}

/// A real recording of the fixtures' task.
pub(super) fn recording(task: &Task, steps: u8) -> Vec<u8> {
    let mut writer = EpisodeWriter::create(Cursor::new(Vec::new()), &task.spec).unwrap();
    for step in 0..steps {
        let value = f32::from(step);
        let step_ref = StepRef { frames: &[], proprioception: &[value, value * 0.5], action: &[-value] };
        writer.step(1_700_000_000_000_000_000 + i64::from(step) * 100_000_000, step_ref).unwrap();
    }
    writer.finish().unwrap().into_inner()
}

/// Not a test of its own: the inspecting child, when the environment requests it. Otherwise it checks that a child's
/// arguments are parsed back.
#[test]
fn as_inspector() {
    let given = std::env::var(ARGUMENTS).ok();
    let line = given.as_deref().unwrap_or("--recording r --spec s --report p --frames f --memory-bytes 7 --seconds 1");
    let flags = Order::augment_args(clap::Command::new("inspector")).no_binary_name(true);
    let order = Order::from_arg_matches(&flags.get_matches_from(line.split_whitespace())).unwrap();
    match given {
        Some(_) => misbehave(&std::env::var(MISBEHAVIOUR).unwrap(), &order),
        None => assert_eq!((order.memory_bytes, order.seconds), (7, 1)),
    }
}

fn misbehave(misbehaviour: &str, order: &Order) {
    if misbehaviour != "none" {
        apply_limits(order).unwrap();
    }
    match misbehaviour {
        "none" => inspect(order).unwrap(),
        "memory" => {
            let mut hoard: Vec<Vec<u8>> = Vec::new();
            loop {
                hoard.push(vec![1; 1 << 20]);
            }
        }
        "reserve" => drop(std::hint::black_box(Vec::<u8>::with_capacity(20_000_000_000_000))),
        "spin" => loop {
            std::hint::spin_loop();
        },
        "wait" => loop {
            std::thread::park();
        },
        "disk" => {
            let flood = vec![1; 1 << 20];
            let mut file = std::fs::File::create(&order.frames).unwrap();
            loop {
                std::io::Write::write_all(&mut file, &flood).unwrap();
            }
        }
        "panic" => panic!("as hostile bytes would make the reader do"),
        other => unreachable!("no misbehaviour is called {other}"),
    }
}
