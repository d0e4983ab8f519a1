//! A server for one experiment: started on a free port, stopped however the experiment ends.

use std::path::{Path, PathBuf};
use std::process::{ExitStatus, Stdio};
use std::time::Duration;

use gleaner_client::{Client, ClientError};
use rustix::process::{Pid, Signal, kill_process};
use serde::{Deserialize, Serialize};
use tokio::io::{AsyncBufReadExt as _, BufReader, Lines};
use tokio::process::{Child, ChildStdout, Command};

use crate::failure::{Failure, Result};
use crate::interrupt::{Signals, unless};

const READY: &str = "listening on ";
const START_PATIENCE: Duration = Duration::from_secs(60);
// Long enough for a worker to write its checkpoint.
const STOP_PATIENCE: Duration = Duration::from_secs(30);

pub(crate) struct ServerProcess {
    child: Child,
    url: String,
    signals: Signals,
    /// The message of the failure after one of these signals.
    interrupted: &'static str,
}

/// The address of an experiment's server, noted in a file beside its data: after a kill, the next run finds the server
/// that is still running instead of starting a second one on the same data.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct Address {
    pub(crate) url: String,
    pid: i32,
}

impl Address {
    /// The server that a note names, if it still runs on this data.
    pub(crate) async fn left_behind(note: &Path, data: &Path) -> Option<(Self, Client)> {
        let noted: Self = serde_json::from_slice(&std::fs::read(note).ok()?).ok()?;
        // Another process may have the number since, and must not be asked to stop.
        let arguments = std::fs::read(format!("/proc/{}/cmdline", noted.pid)).ok()?;
        arguments.split(|byte| *byte == 0).find(|argument| *argument == data.as_os_str().as_encoded_bytes())?;
        let client = Client::connect(&noted.url, None).await.ok()?;
        Some((noted, client))
    }

    pub(crate) fn note(&self, note: &Path) -> Result<()> {
        let text = serde_json::to_vec(self).map_err(|error| Failure::message(error.to_string()))?;
        Ok(std::fs::write(note, text).map_err(ClientError::io(note))?)
    }

    /// Asks the server to stop; returns before it has stopped.
    pub(crate) fn request_stop(&self) {
        if let Some(pid) = Pid::from_raw(self.pid) {
            // It may have ended meanwhile.
            let _ = kill_process(pid, Signal::TERM);
        }
    }
}

impl ServerProcess {
    /// Starts `binary serve` on a data folder, with further flags, and waits until it listens. Its log goes to a file. If
    /// the keyboard or the system asks to stop meanwhile, the server is stopped and the failure has this message.
    pub(crate) async fn start(
        binary: &Path,
        data: &Path,
        log: &Path,
        flags: &[&str],
        interrupted: &'static str,
    ) -> Result<Self> {
        // Before there is a process that must not outlive this one.
        let mut signals = Signals::listen()?;
        let (child, url) = listening(binary, data, log, flags, signals.next(), interrupted).await?;
        Ok(Self { child, url, signals, interrupted })
    }

    pub(crate) fn url(&self) -> &str {
        &self.url
    }

    /// The note for a later run.
    pub(crate) fn address(&self) -> Address {
        address(&self.child, &self.url)
    }

    /// Does work on this server, which is stopped whether the work succeeds, fails or is interrupted.
    pub(crate) async fn during<T>(self, work: impl AsyncFnOnce(Client) -> Result<T>) -> Result<T> {
        let Self { child, url, mut signals, interrupted } = self;
        let connected = async { work(Client::connect(&url, None).await?).await };
        let done = unless(connected, signals.next(), interrupted).await;
        let stopped = stop(child).await;
        let done = done?;
        stopped.map(|()| done)
    }
}

/// A server that listens, with its address; or, if `stop` completes before, no process and a failure with this message.
async fn listening(
    binary: &Path,
    data: &Path,
    log: &Path,
    flags: &[&str],
    stop_asked: impl Future<Output = Signal>,
    interrupted: &'static str,
) -> Result<(Child, String)> {
    // The log of an earlier server stays; that server may still be writing.
    let log_file = std::fs::OpenOptions::new().create(true).append(true).open(log).map_err(ClientError::io(log))?;
    let mut child = Command::new(binary)
        .args(["serve", "--listen", "127.0.0.1:0", "--data-dir"])
        .arg(data)
        .args(flags)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(log_file)
        .kill_on_drop(true)
        .spawn()
        .map_err(ClientError::io(binary))?;
    let stdout = child.stdout.take().ok_or_else(|| Failure::message("the server's output cannot be read"))?;
    let mut lines = BufReader::new(stdout).lines();
    let listens = async {
        let late = |what: &str| Failure::message(format!("{} {what}; {}", binary.display(), tail(log)));
        match tokio::time::timeout(START_PATIENCE, ready(&mut lines)).await {
            Ok(Some(url)) => Ok(url),
            Ok(None) => Err(late("ended before it was listening")),
            Err(_) => Err(late("was not listening in time")),
        }
    };
    let url = match unless(listens, stop_asked, interrupted).await {
        Ok(url) => url,
        Err(failure) => {
            // The reason is that of the start.
            let _ = stop(child).await;
            return Err(failure);
        }
    };
    // Later output must not fill the pipe.
    tokio::spawn(async move { while let Ok(Some(_)) = lines.next_line().await {} });
    Ok((child, url))
}

fn address(child: &Child, url: &str) -> Address {
    let pid = child.id().and_then(|id| i32::try_from(id).ok()).unwrap_or_default();
    Address { url: url.to_owned(), pid }
}

/// Asks a server to end, and ends it when it does not.
async fn stop(mut child: Child) -> Result<()> {
    address(&child, "").request_stop();
    match tokio::time::timeout(STOP_PATIENCE, child.wait()).await {
        Ok(ended) => well(ended?),
        Err(_) => {
            child.kill().await?;
            Err(Failure::message("the server did not stop on request and was killed"))
        }
    }
}

fn well(status: ExitStatus) -> Result<()> {
    if status.success() { Ok(()) } else { Err(Failure::message(format!("the server failed: {status}"))) }
}

async fn ready(lines: &mut Lines<BufReader<ChildStdout>>) -> Option<String> {
    while let Ok(Some(line)) = lines.next_line().await {
        if let Some(url) = line.trim().strip_prefix(READY) {
            return Some(url.to_owned());
        }
    }
    None
}

// The end of the log, which has the reason.
fn tail(log: &Path) -> String {
    let text = std::fs::read_to_string(log).unwrap_or_default();
    let last: Vec<&str> = text.lines().rev().take(5).collect();
    let last: Vec<&str> = last.into_iter().rev().collect();
    format!("{} ends with: {}", PathBuf::from(log).display(), last.join(" | "))
}

#[cfg(test)]
mod tests {
    use rustix::process::test_kill_process;

    use super::*;
    use std::os::unix::fs::PermissionsExt as _;

    // A stand-in with the server's protocol.
    fn script(folder: &Path, body: &str) -> PathBuf {
        let path = folder.join("server.sh");
        std::fs::write(&path, format!("#!/bin/sh\n{body}\n")).unwrap();
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o755)).unwrap();
        path
    }

    // One test: a script that is written while another test forks could not be executed ("text file busy").
    #[tokio::test]
    async fn a_server_starts_and_stops_and_a_failed_or_interrupted_start_leaves_none() {
        let _alone = crate::interrupt::ALONE.lock().await;
        let folder = tempfile::tempdir().unwrap();
        let log = folder.path().join("log");
        let body =
            "trap 'echo bye >&2; exit 0' TERM\necho listening on http://127.0.0.1:9\nwhile :; do sleep 0.02; done";
        let start = async |body: &str| {
            ServerProcess::start(&script(folder.path(), body), folder.path(), &log, &[], "interrupted").await
        };
        let server = start(body).await.unwrap();
        assert_eq!(server.url(), "http://127.0.0.1:9");
        // The process runs, but does not answer: the note is not used.
        let note = folder.path().join("note");
        server.address().note(&note).unwrap();
        assert!(Address::left_behind(&note, folder.path()).await.is_none());
        // Where it answers, it must have been started on this data.
        let answers = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let url = format!("http://{}", answers.local_addr().unwrap());
        Address { url, ..server.address() }.note(&note).unwrap();
        assert!(Address::left_behind(&note, folder.path()).await.is_some());
        assert!(Address::left_behind(&note, &folder.path().join("other")).await.is_none());
        server.during(async |_| -> Result<()> { panic!("it does not answer") }).await.unwrap_err();
        assert_eq!(std::fs::read_to_string(&log).unwrap(), "bye\n");

        let body = "echo data folder is in use >&2; exit 3";
        let error = start(body).await.err().unwrap();
        assert!(error.to_string().contains("data folder is in use"), "{error}");

        // A signal while it starts: the process is asked to end, and has ended before the failure is there.
        std::fs::remove_file(&log).unwrap();
        let begun = folder.path().join("begun");
        assert!(std::process::Command::new("mkfifo").arg(&begun).status().unwrap().success());
        let stopped = "trap 'echo stopped >&2; exit 0' TERM";
        let body = format!("{stopped}\necho $$ > '{}'\nwhile :; do sleep 0.02; done", begun.display());
        let signalled = async {
            // Opening a FIFO waits for its writer.
            let read = tokio::task::spawn_blocking(move || std::fs::read_to_string(begun).unwrap());
            let pid = Pid::from_raw(read.await.unwrap().trim().parse().unwrap()).unwrap();
            kill_process(rustix::process::getpid(), Signal::TERM).unwrap();
            pid
        };
        let (started, pid) = tokio::join!(start(&body), signalled);
        let failure = started.err().unwrap();
        assert_eq!((failure.exit_code(), failure.to_string()), (143, "interrupted".to_owned()));
        assert_eq!(std::fs::read_to_string(&log).unwrap(), "stopped\n");
        assert!(test_kill_process(pid).is_err(), "no process is left");
    }
}
