//! A real server in a process of its own, on port 0, over a temporary directory.

use std::{path::Path, process::Stdio};

use tempfile::TempDir;
use tokio::{
    io::{AsyncBufReadExt as _, BufReader},
    process::{Child, Command},
};

/// A running server; dropped, it is killed and its directory removed.
pub struct TestServer {
    data: TempDir,
    flags: Vec<String>,
    child: Child,
    url: String,
}

impl TestServer {
    /// Starts one on an empty directory.
    pub async fn start() -> Self {
        Self::start_with(&[]).await
    }

    /// Starts one with further flags of `serve`.
    pub async fn start_with(flags: &[&str]) -> Self {
        let data = tempfile::tempdir().unwrap();
        let flags: Vec<String> = flags.iter().map(|&flag| flag.to_owned()).collect();
        let (child, url) = spawn(data.path(), &flags).await;
        Self { data, flags, child, url }
    }

    /// Where it listens.
    pub fn url(&self) -> &str {
        &self.url
    }

    /// Its data directory.
    pub fn data_dir(&self) -> &Path {
        self.data.path()
    }

    /// Its process id.
    pub fn pid(&self) -> u32 {
        self.child.id().unwrap()
    }

    /// Kills it with −9, as a power cut would.
    pub async fn kill(&mut self) {
        self.child.kill().await.unwrap();
    }

    /// Asks it to stop and waits until it has; says whether it ended well.
    pub async fn stop(&mut self) -> bool {
        let pid = rustix::process::Pid::from_raw(i32::try_from(self.pid()).unwrap()).unwrap();
        rustix::process::kill_process(pid, rustix::process::Signal::TERM).unwrap();
        self.child.wait().await.unwrap().success()
    }

    /// Starts it again over the same directory, after `kill` or `stop`; the port is another one.
    pub async fn start_again(&mut self) {
        let (child, url) = spawn(self.data.path(), &self.flags).await;
        (self.child, self.url) = (child, url);
    }

    /// The process ids of its workers.
    pub fn workers(&self) -> Vec<u32> {
        let children = format!("/proc/{0}/task/{0}/children", self.pid());
        let mut found = Vec::new();
        // A child is listed under the thread that started it.
        let tasks = Path::new(&children).parent().unwrap().parent().unwrap().read_dir().unwrap();
        for task in tasks {
            let Ok(list) = std::fs::read_to_string(task.unwrap().path().join("children")) else { continue };
            for pid in list.split_whitespace() {
                let command = std::fs::read(format!("/proc/{pid}/cmdline")).unwrap_or_default();
                if command.split(|&byte| byte == 0).any(|word| word == b"worker") {
                    found.push(pid.parse().unwrap());
                }
            }
        }
        found
    }
}

async fn spawn(data: &Path, flags: &[String]) -> (Child, String) {
    let mut child = Command::new(env!("CARGO_BIN_EXE_gleaner-server-under-test"))
        .args(["serve", "--listen", "127.0.0.1:0", "--worker-threads", "1", "--data-dir"])
        .arg(data)
        .args(flags)
        .env("GLEANER_LOG", std::env::var("GLEANER_LOG").unwrap_or_else(|_| "warn".to_owned()))
        .stdout(Stdio::piped())
        .kill_on_drop(true)
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
    let line = lines.next_line().await.unwrap().expect("the server ended before it listened");
    let url = line.strip_prefix("listening on ").expect("the server's first line names its address").to_owned();
    (child, url)
}
