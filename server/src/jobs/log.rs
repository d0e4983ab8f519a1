//! The output of a job's workers on standard error: passed on to the server's own, and its newest part stored in files
//! for each job. Must not depend on the content of the output.
//!
//! A log is two files: a full newer file replaces the older one. So between `FULL` and twice `FULL` of the newest bytes
//! are stored, whatever the length of the output. A log is not durable: a disk that rejects it does not stop a job.

use std::{
    fs::Metadata,
    io::{ErrorKind, SeekFrom},
    os::unix::fs::MetadataExt as _,
    path::{Path, PathBuf},
};

use bytes::{Bytes, BytesMut};
use gleaner_recording::printable::Escape;
use tokio::{
    fs::{File, OpenOptions},
    io::{AsyncRead, AsyncReadExt as _, AsyncSeekExt as _, AsyncWriteExt as _},
};

use crate::{
    domain::id::JobId,
    error::{Error, Result},
};

/// Bytes after which the newer file replaces the older one.
const FULL: u64 = 256 << 10;
/// Bytes of an unfinished line after which it is passed on in parts.
const LINE: usize = 16 << 10;

/// The log of a job, for writing.
pub(super) struct Log {
    newer: PathBuf,
    older: PathBuf,
    /// The newer file and its size; `None` after a failed write.
    open: Option<(File, u64)>,
}

impl Log {
    /// Opens the log of this job, to append to it.
    pub(super) async fn of(data_dir: &Path, job: &JobId) -> Self {
        let [older, newer] = files(data_dir, job);
        let mut log = Self { newer, older, open: None };
        let opened = async {
            tokio::fs::create_dir_all(gleaner_data_folder::logs(data_dir)).await?;
            log.open().await
        };
        if let Err(error) = opened.await {
            tracing::warn!(%error, "the job's log cannot be opened");
        }
        log
    }

    async fn open(&mut self) -> std::io::Result<()> {
        let file = OpenOptions::new().create(true).append(true).open(&self.newer).await?;
        let size = file.metadata().await?.len();
        self.open = Some((file, size));
        Ok(())
    }

    /// Writes a line of the server's own.
    pub(super) async fn note(&mut self, output: &str) {
        let line = format!("{:.6} gleaner-server: {output}\n", jiff::Timestamp::now());
        self.keep(line.as_bytes()).await;
    }

    /// Stores the output until its end, and passes it on to `others`, in whole lines where they are not too long.
    pub(super) async fn follow(&mut self, mut output: impl AsyncRead + Unpin, mut others: impl AsyncFnMut(Bytes)) {
        let mut lines = BytesMut::with_capacity(LINE);
        while matches!(output.read_buf(&mut lines).await, Ok(1..)) {
            let end = lines.iter().rposition(|&byte| byte == b'\n').map(|at| at + 1);
            if let Some(end) = end.or((lines.len() >= LINE).then_some(lines.len())) {
                let whole = lines.split_to(end).freeze();
                self.keep(&whole).await;
                others(whole).await;
            }
            lines.reserve(LINE);
        }
        if !lines.is_empty() {
            lines.extend_from_slice(b"\n");
            self.keep(&lines).await;
            others(lines.freeze()).await;
        }
    }

    async fn keep(&mut self, lines: &[u8]) {
        if let Err(error) = self.write(lines).await {
            tracing::warn!(%error, "the rest of the job's log cannot be opened");
            self.open = None;
        }
    }

    async fn write(&mut self, lines: &[u8]) -> std::io::Result<()> {
        if let Some((file, FULL..)) = &self.open {
            // Another attempt may have replaced the older file already.
            if file.metadata().await?.ino() == tokio::fs::metadata(&self.newer).await?.ino() {
                tokio::fs::rename(&self.newer, &self.older).await?;
            }
            self.open().await?;
        }
        if let Some((file, size)) = &mut self.open {
            file.write_all(lines).await?;
            // Flushed, so that concurrent readers see the lines.
            file.flush().await?;
            *size += lines.len() as u64;
        }
        Ok(())
    }
}

/// The end of a job's log, of about `most` bytes at most, as text; empty without output.
///
/// # Errors
/// Internal when the disk fails.
pub(super) async fn read(data_dir: &Path, job: &JobId, most: u64) -> Result<String> {
    let bytes = newest(data_dir, job, most).await.map_err(|error| Error::internal("reading a job's log", error))?;
    // Libraries may write any bytes; the result is lines of printable text.
    Ok(Escape::Lines.apply(&String::from_utf8_lossy(&bytes)).into_owned())
}

async fn newest(data_dir: &Path, job: &JobId, most: u64) -> std::io::Result<Vec<u8>> {
    let [older, newer] = files(data_dir, job);
    // The newer file first: if it becomes the older one before that is opened, both are the same file.
    let newer = there(&newer).await?;
    let older =
        there(&older).await?.filter(|(_, older)| newer.as_ref().is_none_or(|(_, newer)| newer.ino() != older.ino()));
    let mut left = most;
    let mut parts = Vec::new();
    for (mut file, about) in [newer, older].into_iter().flatten() {
        let wanted = about.len().min(left);
        left -= wanted;
        file.seek(SeekFrom::Start(about.len() - wanted)).await?;
        let mut part = Vec::new();
        file.take(wanted).read_to_end(&mut part).await?;
        parts.push(part);
    }
    parts.reverse();
    Ok(parts.concat())
}

/// A file, if it exists.
async fn there(path: &Path) -> std::io::Result<Option<(File, Metadata)>> {
    match File::open(path).await {
        Ok(file) => {
            let about = file.metadata().await?;
            Ok(Some((file, about)))
        }
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
        Err(error) => Err(error),
    }
}

/// The older file and the newer one.
fn files(data_dir: &Path, job: &JobId) -> [PathBuf; 2] {
    let folder = gleaner_data_folder::logs(data_dir);
    [folder.join(format!("{job}.older.log")), folder.join(format!("{job}.log"))]
}

#[cfg(test)]
mod tests {
    use super::*;

    const OUTPUT: &[u8] = b"one\ntwo\n\x1b[1mth\xffree";

    #[tokio::test]
    async fn output_is_kept_in_order_across_attempts() {
        let (dir, job) = (tempfile::tempdir().unwrap(), JobId::new());
        assert_eq!(read(dir.path(), &job, u64::MAX).await.unwrap(), "");
        for attempt in 1..=2 {
            let mut log = Log::of(dir.path(), &job).await;
            log.note(&format!("attempt {attempt}")).await;
            let mut others = Vec::new();
            log.follow(OUTPUT, async |lines| others.extend(lines)).await;
            assert_eq!(others, [OUTPUT, b"\n"].concat(), "passed on as it was output");
        }
        let output = read(dir.path(), &job, u64::MAX).await.unwrap();
        let lines: Vec<&str> = output.lines().collect();
        assert_eq!(lines.len(), 8, "{output}");
        assert!(lines[0].ends_with("gleaner-server: attempt 1") && lines[4].ends_with("gleaner-server: attempt 2"));
        assert_eq!(&lines[1..4], ["one", "two", "\\u{1b}[1mth\u{fffd}ree"]);
        assert_eq!(read(dir.path(), &JobId::new(), u64::MAX).await.unwrap(), "", "no other job's");
    }

    #[tokio::test]
    async fn a_long_log_keeps_its_newest_part() {
        let (dir, job) = (tempfile::tempdir().unwrap(), JobId::new());
        let output: String = (0..200_000).map(|line| format!("line {line}\n")).collect();
        Log::of(dir.path(), &job).await.follow(output.as_bytes(), async |_| ()).await;
        let kept = read(dir.path(), &job, u64::MAX).await.unwrap();
        assert!(output.ends_with(&kept), "the newest, without a gap");
        let (least, most) = (usize::try_from(FULL).unwrap(), 3 * usize::try_from(FULL).unwrap());
        assert!((least..most).contains(&kept.len()), "{}", kept.len());
        assert_eq!(read(dir.path(), &job, 100).await.unwrap(), output[output.len() - 100..], "no more than requested");
        assert_eq!(read(dir.path(), &job, FULL).await.unwrap(), kept[kept.len() - least..], "of both files");
        let on_disk: u64 = std::fs::read_dir(gleaner_data_folder::logs(dir.path()))
            .unwrap()
            .map(|file| file.unwrap().metadata().unwrap().len())
            .sum();
        assert_eq!(on_disk, kept.len() as u64);
    }

    #[tokio::test]
    async fn two_concurrent_attempts_rotate_the_log_once() {
        let (dir, job) = (tempfile::tempdir().unwrap(), JobId::new());
        let mut logs = [Log::of(dir.path(), &job).await, Log::of(dir.path(), &job).await];
        let much = vec![b'a'; usize::try_from(FULL).unwrap()];
        for log in &mut logs {
            log.keep(&much).await;
        }
        for log in &mut logs {
            log.keep(b"end\n").await;
        }
        let kept = read(dir.path(), &job, u64::MAX).await.unwrap();
        assert!(kept.len() == 2 * much.len() + 8 && kept.ends_with("aend\nend\n"), "{}", kept.len());
    }

    #[tokio::test]
    async fn an_unfinished_line_does_not_wait_and_a_full_disk_does_not_stop_the_worker() {
        let (dir, job) = (tempfile::tempdir().unwrap(), JobId::new());
        Log::of(dir.path(), &job).await.follow(vec![b'x'; 3 * LINE].as_slice(), async |_| ()).await;
        assert_eq!(read(dir.path(), &job, u64::MAX).await.unwrap().trim_end().len(), 3 * LINE);

        let file = tempfile::NamedTempFile::new().unwrap();
        let mut log = Log::of(file.path(), &job).await;
        log.follow(b"output\n".as_slice(), async |_| ()).await;
        assert!(log.open.is_none());
    }
}
