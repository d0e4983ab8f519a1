//! A server of S3 for tests: moto, which keeps objects in memory and checks no signatures. Where it is not installed, tests
//! print SKIPPED and pass.

use std::{
    io::{Read as _, Result, Write as _},
    net::{TcpListener, TcpStream},
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    time::{Duration, Instant},
};

use gleaner_core::{Secret, error};

use crate::{Bucket, BucketConfig};

/// Name of its bucket.
pub const BUCKET: &str = "lab";
/// Id of its access key.
pub const KEY_ID: &str = "test";
/// Secret of its access key.
pub const KEY: &str = "testtest";
/// The time for its start, beside other work.
const START: Duration = Duration::from_secs(120);

/// A running server with one bucket; it ends on drop.
#[derive(Debug)]
pub struct Moto {
    process: Child,
    address: String,
}

impl Moto {
    /// Starts a server. `None` where moto is not installed.
    ///
    /// # Errors
    /// When it does not start, or makes no bucket.
    pub fn start() -> Result<Option<Self>> {
        let here = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../target/moto/bin/moto_server");
        let program = if here.is_file() { here } else { PathBuf::from("moto_server") };
        let port = TcpListener::bind("127.0.0.1:0")?.local_addr()?.port();
        let started = Command::new(program)
            .args(["-H", "127.0.0.1", "-p", &port.to_string()])
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn();
        let Ok(process) = started else {
            // Past the harness, which captures the output of the macros.
            std::io::stderr().write_all(b"SKIPPED: moto is not installed (make moto)\n")?;
            return Ok(None);
        };
        let mut moto = Self { process, address: format!("127.0.0.1:{port}") };
        let begun = Instant::now();
        while TcpStream::connect(&moto.address).is_err() {
            if moto.process.try_wait()?.is_some() || begun.elapsed() > START {
                return Err(std::io::Error::other("moto does not start"));
            }
            std::thread::park_timeout(Duration::from_millis(20));
        }
        let request = format!(
            "PUT /{BUCKET} HTTP/1.1\r\nHost: {}\r\nContent-Length: 0\r\nConnection: close\r\n\r\n",
            moto.address
        );
        let mut stream = TcpStream::connect(&moto.address)?;
        stream.write_all(request.as_bytes())?;
        let mut answer = String::new();
        stream.read_to_string(&mut answer)?;
        match answer.starts_with("HTTP/1.1 200") {
            true => Ok(Some(moto)),
            false => Err(std::io::Error::other(answer)),
        }
    }

    /// Id of its process.
    pub fn pid(&self) -> u32 {
        self.process.id()
    }

    /// The configuration of a prefix of its bucket.
    pub fn config(&self, prefix: &str) -> BucketConfig {
        BucketConfig {
            url: format!("s3://{BUCKET}/{prefix}"),
            endpoint: Some(format!("http://{}", self.address)),
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

impl Drop for Moto {
    fn drop(&mut self) {
        // It may have ended.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}
