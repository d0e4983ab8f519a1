//! A server in a process of its own: its start, address, memory and end. This module does not depend on what it serves.

use std::path::Path;
use std::process::Stdio;
use std::time::Duration;

use rustix::process::{Pid, Resource, Rlimit, Signal, getrlimit, kill_process, setrlimit};
use tokio::io::{AsyncBufReadExt as _, BufReader};
use tokio::process::{Child, Command};

use crate::Result;

/// The beginning of the line that a server prints once it listens.
const READY: &str = "listening on ";
/// The longest time to start or stop; PyTorch loads slowly on a busy machine.
const LIMIT: Duration = Duration::from_secs(120);

/// A running server; killed on drop.
pub struct Program {
    child: Child,
    url: String,
}

impl Program {
    /// Starts a server with its log in a file; returns once it listens.
    pub async fn start(mut command: Command, log: &Path) -> Result<Self> {
        let mut child = command
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(std::fs::File::create(log)?)
            .kill_on_drop(true)
            .spawn()
            .map_err(|error| format!("{}: {error}", command.as_std().get_program().display()))?;
        let mut lines = BufReader::new(child.stdout.take().ok_or("a program without output")?).lines();
        let ready = async {
            while let Some(line) = lines.next_line().await? {
                if let Some(url) = line.strip_prefix(READY) {
                    return Result::Ok(url.to_owned());
                }
            }
            let text = std::fs::read_to_string(log).unwrap_or_default();
            Err(format!("{} ended before it listened:\n{text}", command.as_std().get_program().display()).into())
        };
        let url = tokio::time::timeout(LIMIT, ready).await.map_err(|_| "a program did not listen in time")??;
        // The server blocks if the pipe is full.
        tokio::spawn(async move { while let Ok(Some(_)) = lines.next_line().await {} });
        Ok(Self { child, url })
    }

    pub fn url(&self) -> &str {
        &self.url
    }

    /// Its memory in bytes.
    pub fn memory(&self) -> Result<u64> {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.child.id().ok_or("it has ended")?))?;
        let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).ok_or("no VmRSS")?;
        let kilobytes: u64 = line.trim().trim_end_matches(" kB").parse()?;
        Ok(kilobytes * 1024)
    }

    /// Stops it with SIGTERM and waits for its end.
    pub async fn stop(mut self) -> Result<()> {
        let pid = self.child.id().and_then(|id| i32::try_from(id).ok()).and_then(Pid::from_raw);
        kill_process(pid.ok_or("the program has ended")?, Signal::TERM)?;
        tokio::time::timeout(LIMIT, self.child.wait()).await.map_err(|_| "a program did not stop in time")??;
        Ok(())
    }
}

/// Raises the limit on open files for thousands of connections, here and in the server, which inherits it.
pub fn allow_open_files() -> Result<()> {
    let Rlimit { maximum, .. } = getrlimit(Resource::Nofile);
    Ok(setrlimit(Resource::Nofile, Rlimit { current: maximum, maximum })?)
}
