//! A real server that encrypts and asks for tokens, with a log of its own to look into.

use std::{
    path::{Path, PathBuf},
    process::Stdio,
};

use gleaner_client::{Client, Credentials};
use rcgen::{BasicConstraints, CertificateParams, CertifiedIssuer, IsCa, KeyPair};
use tempfile::TempDir;
use tokio::process::{Child, Command};

use crate::server::listening;

const SERVER: &str = env!("CARGO_BIN_EXE_gleaner-server-under-test");

/// A running server; dropped, it is killed and its folder removed.
pub struct Guarded {
    folder: TempDir,
    pub url: String,
    pages: Option<String>,
    pub child: Child,
    /// Who signed its certificate.
    pub ca: Vec<u8>,
}

impl Guarded {
    /// Starts one with a certificate for its address, that asks for tokens and logs all there is to log.
    pub async fn start(flags: &[&str], environment: &[(&str, &str)]) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let ca = certify(folder.path());
        let file = |name: &str| folder.path().join(name);
        let log = std::fs::File::create(file("log")).unwrap();
        let mut child = Command::new(SERVER)
            .args(["serve", "--listen", "127.0.0.1:0", "--worker-threads", "1", "--require-tokens", "--data-dir"])
            .arg(file("data"))
            .arg("--tls-cert")
            .arg(file("cert"))
            .arg("--tls-key")
            .arg(file("key"))
            .args(flags)
            .env("GLEANER_LOG", "trace")
            .envs(environment.iter().copied())
            .stdout(Stdio::piped())
            .stderr(log)
            .kill_on_drop(true)
            .spawn()
            .unwrap();
        let (url, pages) = listening(&mut child).await.expect("the server ended before it listened");
        Self { folder, url, pages, child, ca }
    }

    /// Where its pages are, with `--web-listen`.
    pub fn pages(&self) -> &str {
        self.pages.as_deref().expect("started with --web-listen")
    }

    pub fn data_dir(&self) -> PathBuf {
        self.folder.path().join("data")
    }

    /// All it has said.
    pub fn log(&self) -> String {
        String::from_utf8_lossy(&std::fs::read(self.folder.path().join("log")).unwrap()).into_owned()
    }

    /// Neither its log, which should be at its most talkative, nor its database has any of these.
    pub fn tells_nobody<'a>(&self, secrets: impl IntoIterator<Item = &'a str>) {
        let log = self.log();
        assert!(log.contains("TRACE"), "the log is not at its most talkative");
        let files =
            ["gleaner.db", "gleaner.db-wal"].map(|name| std::fs::read(self.data_dir().join(name)).unwrap_or_default());
        for secret in secrets {
            assert!(!log.contains(secret), "{}", log.lines().find(|line| line.contains(secret)).unwrap());
            let tells = |bytes: &[u8]| bytes.windows(secret.len()).any(|part| part == secret.as_bytes());
            assert!(!files.iter().any(|bytes| tells(bytes)));
        }
    }

    /// Sends it SIGHUP.
    pub fn hang_up(&self) {
        let pid = rustix::process::Pid::from_raw(self.child.id().unwrap().try_into().unwrap()).unwrap();
        rustix::process::kill_process(pid, rustix::process::Signal::HUP).unwrap();
    }

    /// Puts a new certificate in place of the one it has, by a new authority.
    pub fn renew(&mut self) {
        self.ca = certify(self.folder.path());
    }

    /// `gleaner-server` beside it, on its folder: what it said, or why it did not do it.
    pub async fn command(&self, words: &[&str]) -> Result<String, String> {
        let output = Command::new(SERVER).args(words).arg("--data-dir").arg(self.data_dir()).output().await.unwrap();
        let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap().trim().to_owned();
        if output.status.success() { Ok(text(output.stdout)) } else { Err(text(output.stderr)) }
    }

    /// A new token.
    pub async fn token(&self, role: &str, more: &[&str]) -> String {
        self.command(&[&["token", "create", "--role", role], more].concat()).await.unwrap()
    }

    /// A connection with a token, or without.
    pub async fn client(&self, token: Option<&str>) -> Client {
        self.connect(token).await.unwrap()
    }

    /// As `client`; an error when the certificate is not the newest.
    pub async fn connect(&self, token: Option<&str>) -> gleaner_client::Result<Client> {
        let token = token.map(|token| token.parse().unwrap());
        let credentials = Credentials { token, ca: Some(self.ca.clone()), identity: None };
        Client::connect_with(&self.url, credentials).await
    }
}

/// Puts a certificate and its key for loopback into a folder; gives back who signed it.
pub fn certify(folder: &Path) -> Vec<u8> {
    let authority = authority();
    let key = KeyPair::generate().unwrap();
    let names = ["localhost", "127.0.0.1"].map(str::to_owned);
    let cert = CertificateParams::new(names).unwrap().signed_by(&key, &authority).unwrap();
    std::fs::write(folder.join("cert"), cert.pem()).unwrap();
    std::fs::write(folder.join("key"), key.serialize_pem()).unwrap();
    authority.pem().into_bytes()
}

/// A new authority.
pub fn authority() -> CertifiedIssuer<'static, KeyPair> {
    let mut params = CertificateParams::new(Vec::new()).unwrap();
    params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
    CertifiedIssuer::self_signed(params, KeyPair::generate().unwrap()).unwrap()
}
