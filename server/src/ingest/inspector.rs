//! Runs inspections: child processes, a limited number at once, each with limits and a deadline.

mod extract;
mod failure;

use std::{
    ffi::OsString,
    num::NonZero,
    path::{Path, PathBuf},
    process::{ExitStatus, Stdio},
    time::Duration,
};

use gleaner_inspector::{Order, RecordingsConfig, Verdict};
use gleaner_recording::{Limits, Report, TaskSpec};
use tempfile::TempDir;
use tokio::{
    io::{AsyncBufReadExt as _, AsyncReadExt as _, BufReader},
    process::{ChildStdout, Command},
    time::Instant,
};

use super::{off_runtime, slots::Slots, sync_folder};
use crate::{
    blobs::{Blobs, rename_across_disks},
    config::{LimitConfig, worker_environment},
    domain::client::Client,
    error::{DISK_FULL, Error, Result},
    program::Program,
};

/// The most bytes of a child's standard error kept for the log.
const STDERR_BYTES: u64 = 16 << 10;

/// The most bytes of a child's line.
const LINE_BYTES: u64 = 32;

/// This many bytes of a recording add one second to the limit of its inspection: about a tenth of the rate at which
/// JPEG images are decoded and compressed. The pictures that it states add their own ([`Order::seconds_for`]), because a
/// picture of compressed video may have few bytes.
const BYTES_PER_SECOND: u64 = 512 << 10;

/// More threads would wait for the one that reads the recording.
const MOST_THREADS: usize = 16;

/// Starts inspections.
#[derive(Debug)]
pub(super) struct Inspector {
    /// A program and its first arguments.
    command: Vec<OsString>,
    tmp: PathBuf,
    /// Memory of one inspection.
    pub(super) memory_bytes: u64,
    seconds: u64,
    threads: usize,
    /// The limits on a recording's content.
    pub(super) limits: RecordingsConfig,
    pub(super) slots: Slots,
}

/// An accepted recording.
#[derive(Debug)]
pub(super) struct Inspected {
    pub(super) report: Report,
    pub(super) folder: TempDir,
}

impl Inspector {
    pub(super) fn new(data_dir: &Path, limits: &LimitConfig) -> Result<Self> {
        Ok(Self {
            command: vec![Program::Inspector.path()?.into()],
            tmp: data_dir.join("tmp"),
            memory_bytes: limits.inspect_memory_bytes,
            seconds: limits.inspect_seconds,
            threads: threads(limits),
            limits: limits.recordings.clone(),
            slots: Slots::new(limits.inspect_parallel),
        })
    }

    /// The same limits with another command: the tests' own.
    #[cfg(test)]
    pub(super) fn with_command(self, command: Vec<OsString>) -> Self {
        Self { command, ..self }
    }

    /// Inspects a recording under limits, in a slot of the client's. `shown` is the client's name of the file.
    ///
    /// # Errors
    /// Invalid when the task cannot use the recording, or reading it exceeded a limit; Unavailable when the inspection
    /// was stopped; Internal when it failed otherwise.
    pub(super) async fn inspect(
        &self,
        client: &Client,
        recording: &Path,
        spec: &TaskSpec,
        shown: &str,
    ) -> Result<Inspected> {
        self.inspect_within(&self.limits, client, recording, spec, shown).await
    }

    /// Reads a recording that was accepted before, maybe under wider limits on its content than today's.
    ///
    /// # Errors
    /// As [`Inspector::inspect`].
    pub(super) async fn inspect_admitted(&self, recording: &Path, spec: &TaskSpec) -> Result<Inspected> {
        let admitted = RecordingsConfig::from(Limits::ADMITTED);
        self.inspect_within(&admitted, &Client::Server, recording, spec, "the stored recording").await
    }

    async fn inspect_within(
        &self,
        limits: &RecordingsConfig,
        client: &Client,
        recording: &Path,
        spec: &TaskSpec,
        shown: &str,
    ) -> Result<Inspected> {
        let _slot = self.slots.take(client).await?;
        let folder = self.prepare(Some(spec)).await?;
        let order = Order { limits: limits.clone(), ..self.order(recording, folder.path()).await? };
        let Verdict::Usable(report) = self.verdict(&order, shown).await? else {
            return Err(Error::internal("inspecting a recording", "the verdict has an unexpected kind"));
        };
        Ok(Inspected { report, folder })
    }

    /// Salvages a torn recording to `out`, under the same limits, and returns the number of its actions.
    ///
    /// # Errors
    /// Invalid when it has no usable beginning, or reading it exceeded a limit; Unavailable; Internal.
    pub(super) async fn salvage(&self, torn: &Path, out: &Path) -> Result<u64> {
        let _slot = self.slots.take(&Client::Server).await?;
        let folder = self.prepare(None).await?;
        let order = Order { salvage: Some(out.to_owned()), ..self.order(torn, folder.path()).await? };
        let Verdict::Salvaged(actions) = self.verdict(&order, "the recording").await? else {
            return Err(Error::internal("salvaging a recording", "the verdict has an unexpected kind"));
        };
        Ok(actions)
    }

    async fn prepare(&self, spec: Option<&TaskSpec>) -> Result<TempDir> {
        let (tmp, spec) = (self.tmp.clone(), spec.cloned());
        off_runtime("preparing an inspection", move || prepare(&tmp, spec.as_ref())).await
    }

    /// Orders an inspection of `recording` under our own limits, with all other files in `folder`.
    async fn order(&self, recording: &Path, folder: &Path) -> Result<Order> {
        let file = tokio::fs::metadata(recording).await;
        let size = file.map_err(|error| Error::internal(format!("reading {}", recording.display()), error))?.len();
        Ok(Order {
            recording: recording.to_owned(),
            spec: folder.join(SPEC),
            report: folder.join(REPORT),
            frames: folder.join(FRAMES),
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
            memory_bytes: self.memory_bytes,
            seconds: self.seconds.saturating_add(size / BYTES_PER_SECOND),
            threads: self.threads,
            limits: self.limits.clone(),
        })
    }

    /// The child's verdict, if it accepted the recording.
    async fn verdict(&self, order: &Order, shown: &str) -> Result<Verdict> {
        let (status, stderr_text, seconds) = self.run(order).await?;
        let report = order.report.clone();
        let verdict = off_runtime("reading an inspection's report", move || Ok(std::fs::read(report).ok())).await?;
        let verdict = verdict.and_then(|json| serde_json::from_slice(&json).ok());
        match verdict {
            Some(found @ (Verdict::Usable(_) | Verdict::Salvaged(_) | Verdict::Extracted)) if status.success() => {
                Ok(found)
            }
            Some(Verdict::Refused(why)) if status.success() => {
                // The caller does not know our paths.
                let why = why.replace(&order.recording.display().to_string(), shown);
                Err(failure::refused(&why))
            }
            Some(Verdict::Full(why)) => Err(Error::refused_by_disk(DISK_FULL, "inspecting a recording", why)),
            Some(Verdict::Fault(why)) => Err(Error::internal("inspecting a recording", why)),
            Some(
                Verdict::Usable(_)
                | Verdict::Salvaged(_)
                | Verdict::Surveyed(_)
                | Verdict::Described(_)
                | Verdict::Converted(_)
                | Verdict::Cut(_)
                | Verdict::Extracted
                | Verdict::Refused(_),
            )
            | None => Err(failure::broken(order, status, &stderr_text, seconds)),
        }
    }

    /// Runs the child to its end or the deadline. Returns its exit status, its standard error and the seconds that it had.
    async fn run(&self, order: &Order) -> Result<(ExitStatus, String, u64)> {
        let fault = |error: std::io::Error| Error::internal("running an inspection", error);
        let (program, first) = self.command.split_first().ok_or_else(|| fault(std::io::ErrorKind::NotFound.into()))?;
        let mut child = Command::new(program)
            .args(first)
            .args(order.arguments())
            .env_clear()
            .envs(worker_environment())
            // A backtrace takes more memory than the child has, and it may hang instead of ending.
            .env("RUST_BACKTRACE", "0")
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            // A Ctrl-C at the server's terminal must not reach it; it still ends with the server.
            .process_group(0)
            .kill_on_drop(true)
            .spawn()
            .map_err(fault)?;
        let (begun, mut stdout, stderr) = (Instant::now(), child.stdout.take(), child.stderr.take());
        let errors = tokio::spawn(async move {
            let mut text = Vec::new();
            if let Some(stderr) = stderr {
                stderr.take(STDERR_BYTES).read_to_end(&mut text).await?;
            }
            std::io::Result::Ok(String::from_utf8_lossy(&text).into_owned())
        });
        let line = first_line(stdout.as_mut());
        let line = tokio::time::timeout(Duration::from_secs(order.seconds), line).await;
        let seconds = order.seconds_stated(&line.unwrap_or_default());
        let ended = async { Ok((child.wait().await?, errors.await.map_err(std::io::Error::other)??)) };
        match tokio::time::timeout_at(begun + Duration::from_secs(seconds), ended).await {
            Ok(ended) => ended.map(|(status, errors)| (status, errors, seconds)).map_err(fault),
            Err(_) => {
                child.kill().await.map_err(fault)?;
                Err(failure::took_too_long(seconds))
            }
        }
    }
}

/// The line by which a child states the time that it has; empty if it ends without one.
async fn first_line(stdout: Option<&mut ChildStdout>) -> String {
    let mut line = String::new();
    if let Some(stdout) = stdout {
        // A failure is a child without a line.
        let _ = BufReader::new(stdout.take(LINE_BYTES)).read_line(&mut line).await;
    }
    line
}

/// Threads of one inspection, at most as many as are of use.
fn threads(limits: &LimitConfig) -> usize {
    let processors = std::thread::available_parallelism().map_or(1, NonZero::get);
    let threads = match limits.inspect_threads {
        0 => processors.div_ceil(limits.inspect_parallel.max(1)),
        threads => threads,
    };
    threads.min(MOST_THREADS)
}

const SPEC: &str = "spec.json";
const REPORT: &str = "report.json";
const FRAMES: &str = "frames";

impl Inspected {
    /// The folder of the decoded frames, removed on drop.
    pub(super) fn frames_path(&self) -> PathBuf {
        self.folder.path().join(FRAMES)
    }

    /// Moves the decoded frames to their place in the cache, within the limit on its size.
    pub(super) async fn keep_frames(&self, blobs: &Blobs, place: &Path) -> Result<()> {
        let (from, place, blobs) = (self.frames_path(), place.to_owned(), blobs.clone());
        off_runtime("keeping decoded frames", move || {
            let fault = |error| Error::internal(format!("keeping {}", place.display()), error);
            blobs.caches().fit(std::fs::metadata(&from).map_err(fault)?.len())?;
            std::fs::File::open(&from).and_then(|file| file.sync_all()).map_err(fault)?;
            crate::fail_point::pass("frames.synced");
            rename_across_disks(&from, &place).map_err(fault)?;
            crate::fail_point::pass("frames.renamed");
            place.parent().map_or(Ok(()), sync_folder)
        })
        .await
    }
}

fn prepare(tmp: &Path, spec: Option<&TaskSpec>) -> Result<TempDir> {
    let fault = |error| Error::internal("preparing an inspection", error);
    let folder = tempfile::Builder::new().prefix("inspect-").tempdir_in(tmp).map_err(fault)?;
    if let Some(spec) = spec {
        let json = serde_json::to_vec(spec).map_err(|error| Error::internal("writing a spec", error))?;
        std::fs::write(folder.path().join(SPEC), json).map_err(fault)?;
    }
    Ok(folder)
}
