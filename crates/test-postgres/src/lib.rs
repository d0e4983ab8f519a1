//! A private PostgreSQL for tests: one folder with its data and its socket, no port, and no process left behind.
//!
//! A shell starts the server, and ends it at the end of its input. The test holds the other end of that pipe, so that the
//! server ends with a test that was killed, too.

#![expect(clippy::unwrap_used, clippy::panic, reason = "tests alone use this crate")]

mod proxy;

pub use proxy::Proxy;

use std::{
    fs,
    io::{Read as _, Write as _},
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    sync::{
        LazyLock,
        atomic::{AtomicU32, Ordering},
    },
};

use tempfile::TempDir;

/// The variable that has the tests of the store run on PostgreSQL.
pub const VARIABLE: &str = "GLEANER_TEST_DATABASE";

/// Runs the server in the folder `$1` by the command `$2` … until the input ends, and removes the folder unless the input
/// has a word.
const KEEPER: &str = r#"
folder=$1; shift
"$@" -D "$folder/data" -l "$folder/log" -w -t 60 start >/dev/null 2>&1 && echo started
exec >/dev/null 2>&1
read -r word
"$@" -D "$folder/data" -m immediate -w stop
[ "$word" = keep ] || rm -rf "$folder"
"#;

/// Settings of a server whose data is of no use after a power cut.
const SETTINGS: &str = "listen_addresses = ''\nfsync = off\nfull_page_writes = off\nshared_buffers = 64MB\n\
     max_connections = 300\n";

/// The role whose password is [`PASSWORD`]; all others need none.
pub const GUARDED_ROLE: &str = "guarded";
/// The password of [`GUARDED_ROLE`].
pub const PASSWORD: &str = "open sesame";

/// Whether the tests of the store run on PostgreSQL.
///
/// # Panics
/// When the variable has another value than `sqlite` or `postgres`.
pub fn selected() -> bool {
    match std::env::var(VARIABLE).as_deref() {
        Ok("postgres") => true,
        Ok("sqlite" | "") | Err(_) => false,
        Ok(other) => panic!("{VARIABLE}={other}: sqlite or postgres"),
    }
}

/// The server that the tests of one process share. It ends with the process.
pub fn shared() -> &'static Server {
    static SHARED: LazyLock<Server> = LazyLock::new(Server::start);
    &SHARED
}

/// A running server; it ends on drop.
#[derive(Debug)]
pub struct Server {
    folder: TempDir,
    keeper: Option<Child>,
    databases: AtomicU32,
}

/// The reason why no server can be started here, if there is one.
pub fn missing() -> Option<String> {
    programs().is_none().then(|| "PostgreSQL is not installed (Debian: postgresql)".to_owned())
}

impl Server {
    /// Starts a new server.
    ///
    /// # Panics
    /// When PostgreSQL is not installed or does not start.
    pub fn start() -> Self {
        if let Some(reason) = missing() {
            panic!("{reason}; the tests of {VARIABLE}=postgres need it");
        }
        let folder = tempfile::Builder::new().prefix("postgres").tempdir().unwrap();
        let mut server = Self { folder, keeper: None, databases: AtomicU32::new(0) };
        if rustix::process::getuid().is_root() {
            run(Command::new("chown").arg("postgres").arg(server.folder.path()));
        }
        let data = server.data();
        run(as_postgres("initdb")
            .arg("-D")
            .arg(&data)
            .args(["-U", "gleaner", "-A", "trust", "-E", "UTF8"])
            .args(["--locale=C.UTF-8", "--no-sync"]));
        let rules = format!("local all {GUARDED_ROLE} scram-sha-256\nlocal all all trust\n");
        fs::write(data.join("pg_hba.conf"), rules).unwrap();
        let socket = server.folder.path().display();
        fs::write(data.join("postgresql.conf"), format!("{SETTINGS}unix_socket_directories = '{socket}'\n")).unwrap();
        server.serve();
        server.execute("postgres", &format!("create role {GUARDED_ROLE} superuser login password '{PASSWORD}'"));
        server
    }

    /// A new, empty database.
    pub fn database(&self) -> String {
        let name = format!("test_{}", self.databases.fetch_add(1, Ordering::Relaxed));
        self.execute("postgres", &format!("create database {name}"));
        name
    }

    /// The address of the database of this name, which is new and empty at the first call.
    pub fn database_named(&self, name: &str) -> String {
        let known = self.execute("postgres", &format!("select 1 from pg_database where datname = '{name}'"));
        if known.is_empty() {
            self.execute("postgres", &format!("create database {name}"));
        }
        self.url(name)
    }

    /// The address of a database.
    pub fn url(&self, database: &str) -> String {
        self.url_as("gleaner", database)
    }

    /// The address of a database for a role, with its password if it is given as `role:password`.
    pub fn url_as(&self, role: &str, database: &str) -> String {
        let socket = self.folder.path().display().to_string().replace('/', "%2F");
        format!("postgres://{role}@localhost/{database}?host={socket}")
    }

    /// An address of this machine that no other server of a test has, because the port of every server is the same.
    pub fn own_address() -> String {
        let [.., high, low] = std::process::id().to_be_bytes();
        format!("127.83.{high}.{}", low.max(1))
    }

    /// Restarts the server so that it also listens on this address, with TLS by this certificate and key.
    pub fn serve_tls(&mut self, address: &str, certificate: &str, key: &str) {
        self.stop();
        let data = self.data();
        for (name, content) in [("server.crt", certificate), ("server.key", key)] {
            let path = data.join(name);
            fs::write(&path, content).unwrap();
            fs::set_permissions(&path, std::os::unix::fs::PermissionsExt::from_mode(0o600)).unwrap();
            if rustix::process::getuid().is_root() {
                run(Command::new("chown").arg("postgres").arg(&path));
            }
        }
        append(&data.join("postgresql.conf"), &format!("listen_addresses = '{address}'\nssl = on\n"));
        append(&data.join("pg_hba.conf"), "hostssl all all 127.0.0.0/8 trust\n");
        self.serve();
    }

    /// Runs a statement in a database and returns its rows, one a line.
    ///
    /// # Panics
    /// When it fails.
    pub fn execute(&self, database: &str, statement: &str) -> String {
        let output = self.psql(database, statement).output().unwrap();
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).trim().to_owned();
        assert!(output.status.success(), "{statement}: {}", text(&output.stderr));
        text(&output.stdout)
    }

    /// Kills the server and all its processes at once, as a power cut would.
    pub fn kill(&mut self) {
        let server = fs::read_to_string(self.data().join("postmaster.pid")).unwrap();
        let server = server.lines().next().unwrap();
        let children = Command::new("pgrep").args(["-P", server]).output().unwrap();
        let children = String::from_utf8(children.stdout).unwrap();
        run(Command::new("kill").arg("-KILL").arg(server).args(children.split_whitespace()));
        self.stop();
    }

    /// Stops the server; its clients lose their connections.
    pub fn stop(&mut self) {
        if let Some(mut keeper) = self.keeper.take() {
            // A keeper that has ended reads nothing.
            let _ = keeper.stdin.take().unwrap().write_all(b"keep\n");
            keeper.wait().unwrap();
        }
    }

    /// Starts the server again after it was stopped or killed.
    pub fn serve(&mut self) {
        let mut command = Command::new("sh");
        command.args(["-c", KEEPER, "keeper"]).arg(self.folder.path());
        let control = as_postgres("pg_ctl");
        command.arg(control.get_program()).args(control.get_args());
        let mut keeper = command.stdin(Stdio::piped()).stdout(Stdio::piped()).current_dir("/").spawn().unwrap();
        let mut answer = String::new();
        keeper.stdout.take().unwrap().read_to_string(&mut answer).unwrap();
        self.keeper = Some(keeper);
        let log = || fs::read_to_string(self.folder.path().join("log")).unwrap_or_default();
        assert!(answer.contains("started"), "PostgreSQL does not start: {}", log());
    }

    /// The socket on which it listens.
    fn socket(&self) -> PathBuf {
        self.folder.path().join(".s.PGSQL.5432")
    }

    fn psql(&self, database: &str, statement: &str) -> Command {
        let mut command = Command::new("psql");
        command.args(["-qtA", "-v", "ON_ERROR_STOP=1", "-U", "gleaner", "-h"]).arg(self.folder.path());
        command.args(["-d", database, "-c", statement]);
        command
    }

    fn data(&self) -> PathBuf {
        self.folder.path().join("data")
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.stop();
    }
}

/// The folder of PostgreSQL's own programs, of the newest version.
fn programs() -> Option<PathBuf> {
    let versions = fs::read_dir("/usr/lib/postgresql").ok()?;
    let version = |path: &Path| path.file_name()?.to_str()?.parse::<u32>().ok();
    let newest = versions.filter_map(|entry| Some(entry.ok()?.path())).max_by_key(|path| version(path))?;
    Some(newest.join("bin")).filter(|bin| bin.join("postgres").exists())
}

/// A program of PostgreSQL, which refuses to run as root.
fn as_postgres(program: &str) -> Command {
    let program = programs().unwrap_or_default().join(program);
    if !rustix::process::getuid().is_root() {
        return Command::new(program);
    }
    let mut command = Command::new("setpriv");
    command.args(["--reuid=postgres", "--regid=postgres", "--init-groups"]).arg(program).current_dir("/");
    command
}

fn append(path: &Path, text: &str) {
    let mut file = fs::OpenOptions::new().append(true).open(path).unwrap();
    file.write_all(text.as_bytes()).unwrap();
}

fn run(command: &mut Command) {
    let output = command.output().unwrap();
    assert!(output.status.success(), "{command:?} failed: {}", String::from_utf8_lossy(&output.stderr));
}
