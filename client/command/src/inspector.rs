//! Runs `gleaner-inspector` on recordings of this machine: what they hold, and what a server would say of them; and on
//! datasets of other programs, to make recordings of their episodes.
//!
//! Recordings may be damaged or hostile, so this process does not parse them. Must not know a server.

mod datasets;

use std::os::unix::process::ExitStatusExt as _;
use std::path::{Path, PathBuf};
use std::process::{ExitStatus, Stdio};
use std::time::Duration;

use futures::StreamExt as _;
use gleaner_client::{ClientError, whole_recording};
use gleaner_inspector::{Order, RecordingsConfig, Verdict};
use gleaner_recording::{CutEpisode, Cuts, Limits, Report, Survey, TaskSpec};
use rustix::process::Signal;
use tempfile::TempDir;
use tokio::io::{AsyncBufReadExt as _, AsyncReadExt as _, BufReader};
use tokio::process::Command;
use tokio::time::Instant;

use crate::failure::{Failure, Result};

/// Memory of one inspection, as the server's default.
const MEMORY_BYTES: u64 = 2 << 30;
/// Seconds of one inspection, and the bytes of a recording that add another one, as at the server.
const SECONDS: u64 = 120;
const BYTES_PER_SECOND: u64 = 512 << 10;
/// Inspections at once.
const PARALLEL: usize = 4;
/// The most bytes of a child's standard error that are shown.
const STDERR_BYTES: u64 = 4 << 10;
/// The most bytes of a child's line.
const LINE_BYTES: u64 = 32;
/// The most bytes of a verdict.
const VERDICT_BYTES: u64 = 256 << 20;

/// A verdict of another kind than the order asks for.
const UNEXPECTED: &str = "the verdict has an unexpected kind; install gleaner-inspector of the same version";

/// The program, installed beside this one.
#[derive(Clone, Debug)]
pub(crate) struct Inspector {
    program: PathBuf,
}

/// The result for one recording, or why it cannot be used.
pub(crate) type Inspected<T> = (PathBuf, std::result::Result<T, String>);

impl Inspector {
    /// Finds the program beside this one: `gleaner-inspector` beside `gleaner`, with the same suffix.
    pub(crate) fn find() -> Result<Self> {
        let own = std::env::current_exe()?;
        let name = own.file_name().unwrap_or_default().to_string_lossy();
        let ending = name.strip_prefix("gleaner").unwrap_or_default();
        let program = own.with_file_name(format!("gleaner-inspector{ending}"));
        if !program.is_file() {
            let problem = format!("{} is missing: install gleaner-inspector beside gleaner", program.display());
            return Err(Failure::message(problem));
        }
        Ok(Self { program })
    }

    /// What each recording holds. With a folder, the pictures of recording N go to its folder `N`, or into the folder
    /// itself if there is one recording.
    pub(crate) async fn survey(&self, files: &[PathBuf], pictures: Option<&Path>) -> Result<Vec<Inspected<Survey>>> {
        let one = files.len() == 1;
        let mut folders = Vec::new();
        for number in 0..files.len() {
            let folder = pictures.map(|folder| if one { folder.to_owned() } else { folder.join(number.to_string()) });
            if let Some(folder) = &folder {
                std::fs::create_dir_all(folder).map_err(ClientError::io(folder))?;
            }
            folders.push(folder);
        }
        self.each(
            files,
            |at, order| Order { survey: true, pictures: folders[at].clone(), ..order },
            None,
            |verdict| {
                if let Verdict::Surveyed(survey) = verdict { Some(survey) } else { None }
            },
        )
        .await
    }

    /// What a server would say of each recording as one of this task.
    pub(crate) async fn check(&self, files: &[PathBuf], spec: &TaskSpec) -> Result<Vec<Inspected<Report>>> {
        self.each(
            files,
            |_, order| order,
            Some(spec),
            |verdict| {
                if let Verdict::Usable(report) = verdict { Some(report) } else { None }
            },
        )
        .await
    }

    /// Cuts a recording into files of a folder, one for each episode.
    pub(crate) async fn cut(
        &self,
        recording: &Path,
        cuts: Cuts<'_>,
        out: &Path,
    ) -> Result<std::result::Result<Vec<CutEpisode>, String>> {
        let folder = tempfile::tempdir()?;
        let basic = basic_order(recording, &folder, None)?;
        let basic = Order { frames: out.to_owned(), ..basic };
        let order = match cuts {
            Cuts::Topic(topic) => Order { cut: Some(topic.to_owned()), ..basic },
            Cuts::Ranges(ranges) => {
                let path = folder.path().join("ranges.json");
                let json = serde_json::to_vec(ranges).map_err(|error| Failure::message(error.to_string()))?;
                std::fs::write(&path, json).map_err(ClientError::io(&path))?;
                Order { cut_ranges: Some(path), ..basic }
            }
        };
        Ok(self.verdict(&order).await?.and_then(|verdict| {
            if let Verdict::Cut(episodes) = verdict { Ok(episodes) } else { Err(refusal(verdict)) }
        }))
    }

    async fn each<T>(
        &self,
        files: &[PathBuf],
        order: impl Fn(usize, Order) -> Order,
        spec: Option<&TaskSpec>,
        wanted: impl Fn(Verdict) -> Option<T>,
    ) -> Result<Vec<Inspected<T>>> {
        let (order, wanted) = (&order, &wanted);
        let runs = files.iter().enumerate().map(|(at, path)| async move {
            let folder = tempfile::tempdir()?;
            let recording = match whole_recording(path, folder.path()).await {
                Ok(recording) => recording,
                Err(error) => return Ok((path.clone(), Err(error.to_string()))),
            };
            let order = order(at, basic_order(&recording, &folder, spec)?);
            let verdict = self.verdict(&order).await?;
            let shown = |text: String| text.replace(&recording.display().to_string(), "the recording");
            let found = verdict.and_then(|verdict| {
                if matches!(verdict, Verdict::Refused(_) | Verdict::Full(_) | Verdict::Fault(_)) {
                    return Err(refusal(verdict));
                }
                wanted(verdict).ok_or_else(|| UNEXPECTED.to_owned())
            });
            Ok((path.clone(), found.map_err(shown)))
        });
        let found: Vec<Result<Inspected<T>>> = futures::stream::iter(runs).buffered(PARALLEL).collect().await;
        found.into_iter().collect()
    }

    /// The child's verdict, or why it has none.
    async fn verdict(&self, order: &Order) -> Result<std::result::Result<Verdict, String>> {
        let mut child = Command::new(&self.program)
            .args(order.arguments())
            .env_clear()
            // A backtrace takes more memory than the child has.
            .env("RUST_BACKTRACE", "0")
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .kill_on_drop(true)
            .spawn()
            .map_err(ClientError::io(&self.program))?;
        let (begun, mut line) = (Instant::now(), String::new());
        let (mut stdout, stderr) = (child.stdout.take(), child.stderr.take());
        let errors = tokio::spawn(async move {
            let mut text = Vec::new();
            if let Some(stderr) = stderr {
                stderr.take(STDERR_BYTES).read_to_end(&mut text).await?;
            }
            std::io::Result::Ok(String::from_utf8_lossy(&text).into_owned())
        });
        if let Some(stdout) = &mut stdout {
            let mut stdout = BufReader::new(stdout.take(LINE_BYTES));
            // Without a line in this time, its time is over.
            let _ = tokio::time::timeout(Duration::from_secs(order.seconds), stdout.read_line(&mut line)).await;
        }
        let seconds = order.seconds_stated(&line);
        let ended = async { Ok((child.wait().await?, errors.await.map_err(std::io::Error::other)??)) };
        let (status, errors) = match tokio::time::timeout_at(begun + Duration::from_secs(seconds), ended).await {
            Ok(ended) => ended.map_err(ClientError::io(&self.program))?,
            Err(_) => {
                child.kill().await?;
                return Ok(Err(took_too_long(seconds)));
            }
        };
        let mut json = Vec::new();
        if let Ok(report) = tokio::fs::File::open(&order.report).await {
            report.take(VERDICT_BYTES).read_to_end(&mut json).await?;
        }
        Ok(match serde_json::from_slice(&json) {
            Ok(verdict) if status.success() => Ok(verdict),
            _ => Err(broken(order, status, &errors, seconds)),
        })
    }
}

/// Why there is no result.
fn refusal(verdict: Verdict) -> String {
    match verdict {
        Verdict::Refused(why) | Verdict::Full(why) | Verdict::Fault(why) => why,
        Verdict::Usable(_)
        | Verdict::Salvaged(_)
        | Verdict::Surveyed(_)
        | Verdict::Described(_)
        | Verdict::Converted(_)
        | Verdict::Cut(_)
        | Verdict::Extracted => UNEXPECTED.to_owned(),
    }
}

fn basic_order(recording: &Path, folder: &TempDir, spec: Option<&TaskSpec>) -> Result<Order> {
    let size = std::fs::metadata(recording).map_err(ClientError::io(recording))?.len();
    let at = |name: &str| folder.path().join(name);
    if let Some(spec) = spec {
        let json = serde_json::to_vec(spec).map_err(|error| Failure::message(error.to_string()))?;
        std::fs::write(at("spec.json"), json).map_err(ClientError::io(folder.path()))?;
    }
    Ok(Order {
        recording: recording.to_owned(),
        spec: at("spec.json"),
        report: at("report.json"),
        frames: at("frames"),
        salvage: None,
        survey: false,
        pictures: None,
        describe: false,
        convert: None,
        cut: None,
        cut_ranges: None,
        extract: None,
        success_column: None,
        rate_hz: None,
        memory_bytes: MEMORY_BYTES,
        seconds: SECONDS.saturating_add(size / BYTES_PER_SECOND),
        threads: 1,
        limits: RecordingsConfig::from(Limits::default()),
    })
}

fn took_too_long(seconds: u64) -> String {
    format!("reading it takes more than {seconds} s; record shorter episodes")
}

/// The cause of death of a child without a verdict.
fn broken(order: &Order, status: ExitStatus, stderr_text: &str, seconds: u64) -> String {
    match status.signal().and_then(Signal::from_named_raw) {
        Some(Signal::XCPU) => took_too_long(seconds),
        Some(Signal::XFSZ) => {
            format!("its decoded images take more than {} MiB; record shorter episodes", order.most_written() >> 20)
        }
        Some(Signal::ABORT) => format!(
            "reading it takes more than {} MiB of memory: the file is damaged, or the episode too long; record it again",
            order.memory_bytes >> 20
        ),
        Some(Signal::HUP | Signal::INT | Signal::QUIT | Signal::TERM | Signal::KILL) => {
            "its inspection was stopped; retry".to_owned()
        }
        Some(_) => "the file is damaged and its reader crashed; record the episode again".to_owned(),
        None => format!("its inspection failed ({status}): {}", stderr_text.trim()),
    }
}
