//! A real server with TLS that requires tokens and logs everything, and certificates for it.

use std::{
    fs,
    path::{Path, PathBuf},
};

use gleaner_client::{Client, Credentials};
use rcgen::{BasicConstraints, CertificateParams, CertifiedIssuer, IsCa, KeyPair};
use tempfile::TempDir;

use super::{
    command,
    process::{Running, Signal, signal},
    server::serve,
};

/// A running server with TLS and tokens; killed on drop, with its folder removed.
pub struct SecureServer {
    folder: TempDir,
    pub running: Running,
    /// The certificate of its authority.
    pub ca: Vec<u8>,
}

impl SecureServer {
    /// Starts a server with a certificate for loopback, required tokens, and the log level `trace` unless the
    /// environment changes it.
    pub async fn start(flags: &[&str], environment: &[(&str, &str)]) -> Self {
        Self::start_in(tempfile::tempdir().unwrap(), flags, environment).await
    }

    /// As [`Self::start`], in this folder, where the file `ca` has the certificate of its authority.
    pub async fn start_in(folder: TempDir, flags: &[&str], environment: &[(&str, &str)]) -> Self {
        let ca = certify(folder.path());
        let file = |name: &str| folder.path().join(name);
        let mut command = serve(&file("data"), flags, "127.0.0.1:0");
        command
            .arg("--require-tokens")
            .arg("--tls-cert")
            .arg(file("cert"))
            .arg("--tls-key")
            .arg(file("key"))
            .env("GLEANER_LOG", "trace")
            .envs(environment.iter().copied())
            .stderr(fs::File::create(file("log")).unwrap());
        Self { running: Running::start(&mut command).await, folder, ca }
    }

    /// The address of its pages, with `--web-listen`.
    pub fn pages(&self) -> &str {
        self.running.pages.as_deref().expect("started with --web-listen")
    }

    pub fn data_dir(&self) -> PathBuf {
        self.folder.path().join("data")
    }

    /// The folder around its data folder, with its certificate, its key and its log.
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    pub fn log(&self) -> String {
        String::from_utf8_lossy(&fs::read(self.folder.path().join("log")).unwrap()).into_owned()
    }

    /// Checks that neither the log, which must be at the level `trace`, nor the database contains any of the secrets.
    pub fn expect_no_secret<'a>(&self, secrets: impl IntoIterator<Item = &'a str>) {
        let log = self.log();
        assert!(log.contains("TRACE"), "the log level is not trace");
        let files =
            ["gleaner.db", "gleaner.db-wal"].map(|name| fs::read(self.data_dir().join(name)).unwrap_or_default());
        for secret in secrets {
            assert!(!log.contains(secret), "{}", log.lines().find(|line| line.contains(secret)).unwrap());
            let contains = |bytes: &[u8]| bytes.windows(secret.len()).any(|part| part == secret.as_bytes());
            assert!(!files.iter().any(|bytes| contains(bytes)), "the database contains a secret");
        }
    }

    pub fn hang_up(&self) {
        signal(self.running.pid(), Signal::HUP);
    }

    /// Replaces its certificate by one of a new authority.
    pub fn renew(&mut self) {
        self.ca = certify(self.folder.path());
    }

    /// Runs a command of `gleaner-server` on its data folder; returns the output, or the errors.
    pub async fn command(&self, words: &[&str]) -> Result<String, String> {
        let output = command::server(words, &self.data_dir()).await;
        if output.success { Ok(output.out.trim().to_owned()) } else { Err(output.errors.trim().to_owned()) }
    }

    /// Creates a token.
    pub async fn token(&self, role: &str, more: &[&str]) -> String {
        self.command(&[&["token", "create", "--role", role], more].concat()).await.unwrap()
    }

    /// Connects with or without a token.
    pub async fn client(&self, token: Option<&str>) -> Client {
        self.connect(token).await.unwrap()
    }

    /// Like [`Self::client`]; an error if the server has another certificate than the newest.
    pub async fn connect(&self, token: Option<&str>) -> gleaner_client::Result<Client> {
        let token = token.map(|token| token.parse().unwrap());
        let credentials = Credentials { token, ca: Some(self.ca.clone()), identity: None };
        Client::connect_with(&self.running.url, credentials).await
    }
}

/// Writes a certificate for loopback and its key into a folder; returns the certificate of its authority.
fn certify(folder: &Path) -> Vec<u8> {
    let authority = authority();
    let key = KeyPair::generate().unwrap();
    let names = ["localhost", "127.0.0.1"].map(str::to_owned);
    let cert = CertificateParams::new(names).unwrap().signed_by(&key, &authority).unwrap();
    fs::write(folder.join("cert"), cert.pem()).unwrap();
    fs::write(folder.join("key"), key.serialize_pem()).unwrap();
    fs::write(folder.join("ca"), authority.pem()).unwrap();
    authority.pem().into_bytes()
}

/// A new authority.
pub fn authority() -> CertifiedIssuer<'static, KeyPair> {
    let mut params = CertificateParams::new(Vec::new()).unwrap();
    params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
    CertifiedIssuer::self_signed(params, KeyPair::generate().unwrap()).unwrap()
}
