//! A server of S3 for tests: the one that `GLEANER_TEST_S3` names (`make test-ceph`), or else moto, which keeps objects in
//! memory and checks no signatures. Where moto is not installed, tests print SKIPPED and pass.

use std::{
    io::{Read as _, Result, Write as _},
    net::{SocketAddr, TcpStream},
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    sync::atomic::{AtomicU64, Ordering},
    time::{Duration, Instant, SystemTime},
};

use gleaner_core::{Secret, error};
use tokio::net::TcpSocket;

use crate::{Bucket, BucketConfig};

/// Name of its bucket.
pub const BUCKET: &str = "lab";
/// Id of its access key.
pub const KEY_ID: &str = "test";
/// Secret of its access key.
pub const KEY: &str = "testtest";
/// URL of a server that has the bucket and accepts the key, for tests without moto.
const GIVEN: &str = "GLEANER_TEST_S3";
/// The time for the start of moto, beside other work.
const START: Duration = Duration::from_secs(120);

/// A server with one bucket, and a folder in it that no other test uses.
#[derive(Debug)]
pub struct TestStore {
    /// Ends on drop.
    moto: Option<Child>,
    /// Keeps the port of moto from other programs.
    _port: Option<TcpSocket>,
    endpoint: String,
    /// Begins every prefix.
    folder: String,
}

impl TestStore {
    /// The server that the environment names, or moto. `None` where there is neither.
    ///
    /// # Errors
    /// When moto does not start, or makes no bucket.
    pub fn start() -> Result<Option<Self>> {
        let Ok(endpoint) = std::env::var(GIVEN) else { return Self::moto() };
        static STORES: AtomicU64 = AtomicU64::new(0);
        let since = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
        let number = STORES.fetch_add(1, Ordering::Relaxed);
        let folder = format!("{}-{}-{number}/", std::process::id(), since.as_millis());
        Ok(Some(Self { moto: None, _port: None, endpoint, folder }))
    }

    /// Moto, for tests that stop the server. `None` where it is not installed.
    ///
    /// # Errors
    /// When it does not start, or makes no bucket.
    pub fn moto() -> Result<Option<Self>> {
        let here = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../target/moto/bin/moto_server");
        let program = if here.is_file() { here } else { PathBuf::from("moto_server") };
        // It does not listen, and so leaves the port to moto, which also sets SO_REUSEADDR.
        let port = TcpSocket::new_v4()?;
        port.set_reuseaddr(true)?;
        port.bind(SocketAddr::from(([127, 0, 0, 1], 0)))?;
        let address = port.local_addr()?;
        let started = Command::new(program)
            .args(["-H", "127.0.0.1", "-p", &address.port().to_string()])
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn();
        let Ok(process) = started else {
            // Past the harness, which captures the output of the macros.
            std::io::stderr().write_all(b"SKIPPED: moto is not installed (make moto)\n")?;
            return Ok(None);
        };
        let (endpoint, folder) = (format!("http://{address}"), String::new());
        let mut store = Self { moto: Some(process), _port: Some(port), endpoint, folder };
        let begun = Instant::now();
        let request =
            format!("PUT /{BUCKET} HTTP/1.1\r\nHost: {address}\r\nContent-Length: 0\r\nConnection: close\r\n\r\n");
        let ask = || -> std::io::Result<String> {
            let mut stream = TcpStream::connect(address)?;
            stream.write_all(request.as_bytes())?;
            let mut answer = String::new();
            stream.read_to_string(&mut answer)?;
            Ok(answer)
        };
        // While it starts, connections are refused, and on a busy machine also reset.
        let answer = loop {
            let error = match ask() {
                Ok(answer) => break answer,
                Err(error) => error,
            };
            let ended = store.moto.as_mut().map(Child::try_wait).transpose()?.flatten().is_some();
            if ended || begun.elapsed() > START {
                return Err(std::io::Error::other(format!("moto does not start: {error}")));
            }
            std::thread::park_timeout(Duration::from_millis(20));
        };
        match answer.starts_with("HTTP/1.1 200") {
            true => Ok(Some(store)),
            false => Err(std::io::Error::other(answer)),
        }
    }

    /// Id of the process of moto; `None` for another server.
    pub fn pid(&self) -> Option<u32> {
        self.moto.as_ref().map(Child::id)
    }

    /// The configuration of a prefix of its bucket.
    pub fn config(&self, prefix: &str) -> BucketConfig {
        BucketConfig {
            url: format!("s3://{BUCKET}/{}{prefix}", self.folder),
            endpoint: Some(self.endpoint.clone()),
            region: None,
            http: true,
            virtual_host: false,
            timeout_seconds: 60,
        }
    }

    /// A prefix of its bucket.
    ///
    /// # Errors
    /// Precondition when the prefix cannot be used.
    pub fn bucket(&self, prefix: &str) -> error::Result<Bucket> {
        Bucket::open_with_key(&self.config(prefix), (KEY_ID, &Secret::from(KEY.to_owned())))
    }
}

impl Drop for TestStore {
    fn drop(&mut self) {
        if let Some(moto) = &mut self.moto {
            // It may have ended.
            let _ = moto.kill();
            let _ = moto.wait();
        }
    }
}
