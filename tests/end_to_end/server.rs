//! A real server in a process of its own, on port 0, over a temporary directory.

use std::{
    path::{Path, PathBuf},
    process::Stdio,
};

use tempfile::TempDir;
use tokio::{
    io::{AsyncBufReadExt as _, BufReader},
    process::{Child, Command},
};

/// A running server; dropped, it is killed and its directory removed.
pub struct TestServer {
    data: PathBuf,
    /// Removed with the server.
    _own: Option<TempDir>,
    flags: Vec<String>,
    child: Child,
    url: String,
    pages: Option<String>,
}

impl TestServer {
    /// Starts one on an empty directory.
    pub async fn start() -> Self {
        Self::start_with(&[]).await
    }

    /// Starts one with further flags of `serve`.
    pub async fn start_with(flags: &[&str]) -> Self {
        let owner_only = std::os::unix::fs::PermissionsExt::from_mode(0o700);
        let own = tempfile::Builder::new().permissions(owner_only).tempdir().unwrap();
        let server = Self::start_over(own.path(), flags).await;
        Self { _own: Some(own), ..server }
    }

    /// Starts one over a directory that stays.
    pub async fn start_over(data: &Path, flags: &[&str]) -> Self {
        let flags: Vec<String> = flags.iter().map(|&flag| flag.to_owned()).collect();
        let (child, url, pages) = spawn(data, &flags).await;
        Self { data: data.to_owned(), _own: None, flags, child, url, pages }
    }

    /// Where it listens.
    pub fn url(&self) -> &str {
        &self.url
    }

    /// Where its workers call.
    pub fn workers_url(&self) -> String {
        let others: Vec<&str> = [Some(self.url()), self.pages.as_deref()].into_iter().flatten().collect();
        let apart = |port: &u16| !others.iter().any(|url| url.split(['/', ':']).any(|part| part == port.to_string()));
        format!("http://127.0.0.1:{}", ports(self.pid()).into_iter().find(apart).unwrap())
    }

    /// Where its pages are, with `--web-listen`.
    pub fn pages(&self) -> &str {
        self.pages.as_deref().expect("started with --web-listen")
    }

    /// Where its metrics are, with `--web-listen`.
    pub fn metrics(&self) -> String {
        format!("{}/metrics", self.pages())
    }

    /// Its data directory.
    pub fn data_dir(&self) -> &Path {
        &self.data
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
        (self.child, self.url, self.pages) = spawn(&self.data, &self.flags).await;
    }

    /// Starts it again over the same directory and on the same address, to die at a fail point if one is named. False
    /// when it has died before it listened.
    pub async fn start_where_it_was(&mut self, fail_point: Option<&str>) -> bool {
        let address = self.url.strip_prefix("http://").unwrap();
        free(address).await;
        let mut command = serve(&self.data, &self.flags, address);
        command.envs(fail_point.map(|name| ("GLEANER_FAIL_POINT", name)));
        self.child = command.spawn().unwrap();
        listening(&mut self.child).await.is_some()
    }

    /// Starts one that may write files of at most so many bytes (`ulimit -f`).
    pub async fn start_with_file_limit(bytes: u64, flags: &[&str]) -> Self {
        let own = tempfile::tempdir().unwrap();
        let flags: Vec<String> = flags.iter().map(|&flag| flag.to_owned()).collect();
        let plain = serve(own.path(), &flags, "127.0.0.1:0");
        let mut command = Command::new("prlimit");
        command.arg(format!("--fsize={bytes}")).arg(plain.as_std().get_program()).args(plain.as_std().get_args());
        command.env("GLEANER_LOG", QUIET).stdout(Stdio::piped()).kill_on_drop(true);
        let mut child = command.spawn().unwrap();
        let (url, pages) = listening(&mut child).await.expect("the server ended before it listened");
        Self { data: own.path().to_owned(), _own: Some(own), flags, child, url, pages }
    }

    /// Changes the limit on files of the running server; `None` lifts it.
    pub fn limit_files(&self, bytes: Option<u64>) {
        let pid = rustix::process::Pid::from_raw(i32::try_from(self.pid()).unwrap());
        let limit = rustix::process::Rlimit { current: bytes, maximum: None };
        rustix::process::prlimit(pid, rustix::process::Resource::Fsize, limit).unwrap();
    }

    /// Starts one as the first process of a namespace of its own, as in a container; `None` where that may not be.
    pub async fn start_as_init(data: &Path, flags: &[&str]) -> Option<Self> {
        let unshare = ["--user", "--map-root-user", "--pid", "--fork", "--kill-child"];
        let allowed = Command::new("unshare").args(unshare).arg("true").stderr(Stdio::null()).status().await;
        if !allowed.is_ok_and(|status| status.success()) {
            return None;
        }
        let flags: Vec<String> = flags.iter().map(|&flag| flag.to_owned()).collect();
        let plain = serve(data, &flags, "127.0.0.1:0");
        let mut command = Command::new("unshare");
        command.args(unshare).arg(plain.as_std().get_program()).args(plain.as_std().get_args());
        let mut child = command.stdout(Stdio::piped()).kill_on_drop(true).spawn().unwrap();
        let (url, pages) = listening(&mut child).await.expect("the server ended before it listened");
        Some(Self { data: data.to_owned(), _own: None, flags, child, url, pages })
    }

    /// Asks the child of what was started to stop.
    pub fn terminate(&self) {
        let children = std::fs::read_to_string(format!("/proc/{0}/task/{0}/children", self.pid())).unwrap();
        let pid = rustix::process::Pid::from_raw(children.split_whitespace().next().unwrap().parse().unwrap()).unwrap();
        rustix::process::kill_process(pid, rustix::process::Signal::TERM).unwrap();
    }

    /// Waits until it has ended; says whether well.
    pub async fn ended(&mut self) -> bool {
        self.child.wait().await.unwrap().success()
    }

    /// Waits until it has died by itself.
    pub async fn died(&mut self) {
        self.child.wait().await.unwrap();
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
                if command.split(|&byte| byte == 0).any(|word| word.ends_with(b"gleaner-worker-under-test")) {
                    found.push(pid.parse().unwrap());
                }
            }
        }
        found
    }
}

/// Little is said, but what workers say is looked for in their jobs' logs.
const QUIET: &str = "warn,gleaner_server::worker=info";

/// Where a server listens, and where its pages are if anywhere.
type Addresses = (String, Option<String>);

async fn spawn(data: &Path, flags: &[String]) -> (Child, String, Option<String>) {
    let mut child = serve(data, flags, "127.0.0.1:0").spawn().unwrap();
    let (url, pages) = listening(&mut child).await.expect("the server ended before it listened");
    (child, url, pages)
}

fn serve(data: &Path, flags: &[String], listen: &str) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_gleaner-server-under-test"));
    command
        .args(["serve", "--listen", listen, "--worker-threads", "1", "--data-dir"])
        .arg(data)
        .args(flags)
        .env("GLEANER_LOG", std::env::var("GLEANER_LOG").unwrap_or_else(|_| QUIET.to_owned()))
        .stdout(Stdio::piped())
        .kill_on_drop(true);
    command
}

/// Its first lines name its addresses. `None` when it has ended without them.
pub async fn listening(child: &mut Child) -> Option<Addresses> {
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
    let mut pages = None;
    loop {
        let line = lines.next_line().await.unwrap()?;
        match line.strip_prefix("pages on ") {
            Some(url) => pages = Some(url.to_owned()),
            None => {
                let url = line.strip_prefix("listening on ").expect("the server's first lines name its addresses");
                return Some((url.to_owned(), pages));
            }
        }
    }
}

/// Returns once the address can be bound: a connection of another test may have been given the port meanwhile.
async fn free(address: &str) {
    let mut ticks = tokio::time::interval(std::time::Duration::from_millis(20));
    while std::net::TcpListener::bind(address).is_err() {
        ticks.tick().await;
    }
}

/// The ports of IPv4 loopback that a process listens on.
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
