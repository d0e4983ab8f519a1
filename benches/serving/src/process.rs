//! A server in a process of its own, ours or a peer's: where it listens, what memory it holds, and its end. Knows
//! nothing of what it serves.

use std::path::Path;
use std::process::Stdio;
use std::time::Duration;

use rustix::process::{Pid, Resource, Rlimit, Signal, getrlimit, kill_process, setrlimit};
use tokio::io::{AsyncBufReadExt as _, BufReader};
use tokio::process::{Child, Command};

use crate::Result;

/// What each of them prints once it can be reached.
const READY: &str = "listening on ";
/// PyTorch takes long to load on a busy machine.
const PATIENCE: Duration = Duration::from_secs(120);

/// A running server; dropped, it is killed.
pub struct Program {
    child: Child,
    url: String,
}

impl Program {
    /// Starts it and waits until it listens. What it logs goes to a file.
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
            let said = std::fs::read_to_string(log).unwrap_or_default();
            Err(format!("{} ended before it listened:\n{said}", command.as_std().get_program().display()).into())
        };
        let url = tokio::time::timeout(PATIENCE, ready).await.map_err(|_| "a program did not listen in time")??;
        // What else it prints must not fill the pipe.
        tokio::spawn(async move { while let Ok(Some(_)) = lines.next_line().await {} });
        Ok(Self { child, url })
    }

    pub fn url(&self) -> &str {
        &self.url
    }

    /// Bytes of memory it holds now.
    pub fn memory(&self) -> Result<u64> {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.child.id().ok_or("it has ended")?))?;
        let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).ok_or("no VmRSS")?;
        let kilobytes: u64 = line.trim().trim_end_matches(" kB").parse()?;
        Ok(kilobytes * 1024)
    }

    /// Asks it to end and waits until it has.
    pub async fn stop(mut self) -> Result<()> {
        let pid = self.child.id().and_then(|id| i32::try_from(id).ok()).and_then(Pid::from_raw);
        kill_process(pid.ok_or("it has ended by itself")?, Signal::TERM)?;
        tokio::time::timeout(PATIENCE, self.child.wait())
            .await
            .map_err(|_| "a program did not end when asked to")??;
        Ok(())
    }
}

/// A thousand connections are a thousand files, here and in the server, which inherits the limit.
pub fn allow_open_files() -> Result<()> {
    let Rlimit { maximum, .. } = getrlimit(Resource::Nofile);
    Ok(setrlimit(Resource::Nofile, Rlimit { current: maximum, maximum })?)
}
