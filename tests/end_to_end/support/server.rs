//! A real server in a process of its own, on port 0, over a temporary data folder.

use std::{
    path::{Path, PathBuf},
    process::Stdio,
    time::Duration,
};

use tempfile::TempDir;
use tokio::process::Command;

use super::{
    database,
    process::{self, Running, SERVER, Signal, ports, signal},
};

/// Warnings, and the messages of workers, because tests search for them in the logs of jobs.
const LOG_LEVELS: &str = "warn,gleaner_worker=info";
const ANY_PORT: &str = "127.0.0.1:0";

/// A running server; killed on drop, with its data folder removed if it was made for it.
pub struct TestServer {
    data: PathBuf,
    /// Removed with the server.
    _own: Option<TempDir>,
    flags: Vec<String>,
    running: Running,
}

impl TestServer {
    /// Starts a server on an empty data folder.
    pub async fn start() -> Self {
        Self::start_with(&[]).await
    }

    /// Starts a server on an empty data folder with these flags of `serve`.
    pub async fn start_with(flags: &[&str]) -> Self {
        let own = own_folder();
        let server = Self::start_over(own.path(), flags).await;
        Self { _own: Some(own), ..server }
    }

    /// Like [`Self::start_with`]. `None` if the server ends before it listens.
    pub async fn try_start_with(flags: &[&str]) -> Option<Self> {
        let own = own_folder();
        let running = Running::try_start(&mut serve(own.path(), flags, ANY_PORT)).await?;
        let flags = flags.iter().map(|&flag| flag.to_owned()).collect();
        Some(Self { data: own.path().to_owned(), _own: Some(own), flags, running })
    }

    /// Starts a server over a data folder that stays.
    pub async fn start_over(data: &Path, flags: &[&str]) -> Self {
        let command = serve(data, flags, ANY_PORT);
        Self::run(command, data, flags).await
    }

    /// Starts a server whose log at these levels goes to a file; see [`Self::log`].
    pub async fn start_logged(flags: &[&str], levels: &str) -> Self {
        let own = own_folder();
        let data = own.path().join("data");
        let mut command = serve(&data, flags, ANY_PORT);
        command.env("GLEANER_LOG", levels).stderr(std::fs::File::create(own.path().join("log")).unwrap());
        let server = Self::run(command, &data, flags).await;
        Self { _own: Some(own), ..server }
    }

    /// Starts a server with a limit on the size of files, in bytes (`ulimit -f`).
    pub async fn start_with_file_limit(bytes: u64, flags: &[&str]) -> Self {
        let own = own_folder();
        let starter = ["prlimit".to_owned(), format!("--fsize={bytes}")];
        let server = Self::run(serve_by(&starter, own.path(), flags, ANY_PORT), own.path(), flags).await;
        Self { _own: Some(own), ..server }
    }

    /// Starts a server as process 1 of a namespace of its own, as in a container. `None` where that is not allowed.
    pub async fn start_as_init(data: &Path, flags: &[&str]) -> Option<Self> {
        let starter = ["unshare", "--user", "--map-root-user", "--pid", "--fork", "--kill-child"].map(str::to_owned);
        let mut allowed = Command::new(&starter[0]);
        let allowed = allowed.args(&starter[1..]).arg("true").stderr(Stdio::null()).status().await;
        if !allowed.is_ok_and(|status| status.success()) {
            return None;
        }
        Some(Self::run(serve_by(&starter, data, flags, ANY_PORT), data, flags).await)
    }

    async fn run(mut command: Command, data: &Path, flags: &[&str]) -> Self {
        let running = Running::start(&mut command).await;
        let flags = flags.iter().map(|&flag| flag.to_owned()).collect();
        Self { data: data.to_owned(), _own: None, flags, running }
    }

    /// The address of its services.
    pub fn url(&self) -> &str {
        &self.running.url
    }

    /// The address of its services without the scheme.
    pub fn address(&self) -> &str {
        self.url().strip_prefix("http://").unwrap()
    }

    /// The address of its worker service.
    pub fn workers_url(&self) -> String {
        let others: Vec<&str> = [Some(self.url()), self.running.pages.as_deref()].into_iter().flatten().collect();
        let apart = |port: &u16| !others.iter().any(|url| url.split(['/', ':']).any(|part| part == port.to_string()));
        format!("http://127.0.0.1:{}", ports(self.pid()).into_iter().find(apart).unwrap())
    }

    /// The address of its pages, with `--web-listen`.
    pub fn pages(&self) -> &str {
        self.running.pages.as_deref().expect("started with --web-listen")
    }

    /// The address of its metrics, with `--web-listen`.
    pub fn metrics(&self) -> String {
        format!("{}/metrics", self.pages())
    }

    pub fn data_dir(&self) -> &Path {
        &self.data
    }

    pub fn pid(&self) -> u32 {
        self.running.pid()
    }

    /// The log of a server of [`Self::start_logged`].
    pub fn log(&self) -> String {
        std::fs::read_to_string(self.data.with_file_name("log")).unwrap()
    }

    /// Kills it with SIGKILL, as a power cut would.
    pub async fn kill(&mut self) {
        self.running.child.kill().await.unwrap();
    }

    /// Kills its workers with SIGKILL.
    pub fn kill_workers(&self) {
        for worker in process::workers(self.pid()) {
            // A worker that has ended meanwhile is gone.
            let _ = process::try_signal(worker, Signal::KILL);
        }
    }

    /// Stops it with SIGTERM and waits for its end; returns whether it succeeded.
    pub async fn stop(&mut self) -> bool {
        signal(self.pid(), Signal::TERM);
        self.ended().await
    }

    /// Stops the server that was started by another program.
    pub fn terminate_child(&self) {
        signal(process::children(self.pid())[0], Signal::TERM);
    }

    /// Waits for its end; returns whether it succeeded.
    pub async fn ended(&mut self) -> bool {
        self.running.child.wait().await.unwrap().success()
    }

    /// Starts it again over the same data folder, after `kill` or `stop`, on another port.
    pub async fn start_again(&mut self) {
        self.running = Running::start(&mut serve(&self.data, &self.flags, ANY_PORT)).await;
    }

    /// Starts it again over the same data folder and on the same address, with a fail point if one is named. False if it
    /// died before it listened.
    pub async fn start_where_it_was(&mut self, fail_point: Option<&str>) -> bool {
        let address = self.address();
        free(address).await;
        let mut command = serve(&self.data, &self.flags, address);
        command.envs(fail_point.map(|name| ("GLEANER_FAIL_POINT", name)));
        match Running::try_start(&mut command).await {
            Some(running) => {
                self.running = running;
                true
            }
            None => false,
        }
    }

    /// Changes the limit on the size of files of the running server; `None` lifts it.
    pub fn limit_files(&self, bytes: Option<u64>) {
        let pid = rustix::process::Pid::from_raw(i32::try_from(self.pid()).unwrap());
        let limit = rustix::process::Rlimit { current: bytes, maximum: None };
        rustix::process::prlimit(pid, rustix::process::Resource::Fsize, limit).unwrap();
    }
}

/// A folder with the permissions that a server requires of its data folder.
fn own_folder() -> TempDir {
    let owner_only = std::os::unix::fs::PermissionsExt::from_mode(0o700);
    tempfile::Builder::new().permissions(owner_only).tempdir().unwrap()
}

/// The command that serves a data folder on an address.
pub fn serve(data: &Path, flags: &[impl AsRef<str>], listen: &str) -> Command {
    serve_by(&[], data, flags, listen)
}

/// Like [`serve`], by a program that starts the server.
pub fn serve_by(starter: &[String], data: &Path, flags: &[impl AsRef<str>], listen: &str) -> Command {
    let mut words = starter.iter().map(String::as_str).chain([SERVER]);
    let mut command = Command::new(words.next().unwrap());
    command
        .args(words)
        .args(["serve", "--listen", listen, "--worker-threads", "1", "--data-dir"])
        .arg(data)
        .args(flags.iter().map(AsRef::as_ref))
        .envs(database::of(data))
        .env("GLEANER_LOG", std::env::var("GLEANER_LOG").unwrap_or_else(|_| LOG_LEVELS.to_owned()))
        .env("AWS_ACCESS_KEY_ID", gleaner_bucket::testing::KEY_ID)
        .env("AWS_SECRET_ACCESS_KEY", gleaner_bucket::testing::KEY)
        .stdout(Stdio::piped())
        .kill_on_drop(true);
    command
}

/// Returns once the address can be bound: a connection of another test may have received the port meanwhile.
async fn free(address: &str) {
    let mut ticks = tokio::time::interval(Duration::from_millis(20));
    while std::net::TcpListener::bind(address).is_err() {
        ticks.tick().await;
    }
}
