//! Processes: the programs under test, signals, the workers of a server, and the addresses on which it listens.

use std::path::PathBuf;

use rustix::process::{Pid, kill_process};
use tokio::{
    io::{AsyncBufReadExt as _, BufReader},
    process::{Child, Command},
};

pub use rustix::process::Signal;

pub const SERVER: &str = env!("CARGO_BIN_EXE_gleaner-server-under-test");
pub const GLEANER: &str = env!("CARGO_BIN_EXE_gleaner-under-test");

/// A server that listens. It is killed on drop if its command has `kill_on_drop`.
pub struct Running {
    pub child: Child,
    pub url: String,
    pub pages: Option<String>,
}

impl Running {
    /// Starts a command of `gleaner-server serve` whose output is piped; returns once the server listens.
    pub async fn start(command: &mut Command) -> Self {
        Self::try_start(command).await.expect("the server ended before it listened")
    }

    /// Like [`Self::start`]. `None` if the server ends before it listens.
    pub async fn try_start(command: &mut Command) -> Option<Self> {
        let mut child = command.spawn().unwrap();
        let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
        let mut pages = None;
        loop {
            let line = lines.next_line().await.unwrap()?;
            match line.strip_prefix("pages on ") {
                Some(url) => pages = Some(url.to_owned()),
                None => {
                    let url =
                        line.strip_prefix("listening on ").expect("the first lines of a server are its addresses");
                    return Some(Self { child, url: url.to_owned(), pages });
                }
            }
        }
    }

    pub fn pid(&self) -> u32 {
        self.child.id().unwrap()
    }
}

/// Sends a signal to a process that exists.
pub fn signal(pid: u32, signal: Signal) {
    try_signal(pid, signal).unwrap();
}

/// Sends a signal; fails if the process does not exist.
pub fn try_signal(pid: u32, signal: Signal) -> rustix::io::Result<()> {
    kill_process(Pid::from_raw(pid.try_into().unwrap()).unwrap(), signal)
}

/// The process ids of a process's children. A child is listed under the thread that started it.
pub fn children(pid: u32) -> Vec<u32> {
    let threads = std::fs::read_dir(format!("/proc/{pid}/task")).unwrap();
    let lists = threads.filter_map(|thread| std::fs::read_to_string(thread.unwrap().path().join("children")).ok());
    lists.flat_map(|list| list.split_whitespace().map(|pid| pid.parse().unwrap()).collect::<Vec<u32>>()).collect()
}

/// The process ids of a server's workers.
pub fn workers(server: u32) -> Vec<u32> {
    let is_worker = |pid: &u32| {
        let command = std::fs::read(format!("/proc/{pid}/cmdline")).unwrap_or_default();
        command.split(|&byte| byte == 0).any(|word| word.ends_with(b"gleaner-worker-under-test"))
    };
    children(server).into_iter().filter(is_worker).collect()
}

/// The value of an option of a process, such as `--rank`.
pub fn argument(pid: u32, name: &str) -> Option<String> {
    let command = std::fs::read(format!("/proc/{pid}/cmdline")).unwrap_or_default();
    let mut words = command.split(|&byte| byte == 0).map(|word| String::from_utf8_lossy(word).into_owned());
    words.find(|word| word == name)?;
    words.next()
}

/// Sends a signal to rank 1 of the only attempt that runs on this server.
pub fn signal_rank_1(server: u32, sent: Signal) {
    let ranks = workers(server).into_iter();
    let rank_1: Vec<u32> = ranks.filter(|&pid| argument(pid, "--rank").as_deref() == Some("1")).collect();
    assert_eq!(rank_1.len(), 1, "the attempt is in the middle");
    signal(rank_1[0], sent);
}

/// The ports of IPv4 loopback on which a process listens.
pub fn ports(pid: u32) -> Vec<u16> {
    let files = std::fs::read_dir(format!("/proc/{pid}/fd")).unwrap();
    let open: Vec<PathBuf> = files.filter_map(|file| std::fs::read_link(file.unwrap().path()).ok()).collect();
    let sockets = std::fs::read_to_string(format!("/proc/{pid}/net/tcp")).unwrap();
    let listening = sockets.lines().filter_map(|line| {
        let cells: Vec<&str> = line.split_whitespace().collect();
        let port = cells.get(1)?.strip_prefix("0100007F:")?;
        let own = open.contains(&PathBuf::from(format!("socket:[{}]", cells.get(9)?)));
        (own && cells[3] == "0A").then(|| u16::from_str_radix(port, 16).unwrap())
    });
    listening.collect()
}
