//! Reads files at signed URLs, without credentials of the bucket. A read that is interrupted resumes at another URL of the
//! same file.

use std::{
    fs::File,
    io::{Seek as _, Write as _},
    iter::successors,
    sync::{Mutex, OnceLock, PoisonError},
    time::{Duration, Instant},
};

use gleaner_core::{
    Secret,
    error::{Error, Result},
    id::BlobId,
};
use reqwest::{Client, StatusCode, header::RANGE, redirect::Policy};

use super::wait::wait;

/// The time to open a connection: the bucket may be in a network that this machine cannot reach.
const CONNECT: Duration = Duration::from_secs(3);
/// The time without a byte after which a read fails.
const SILENCE: Duration = Duration::from_secs(20);
/// The time for which a closed reader stays closed: each attempt to reach an absent bucket lasts up to [`CONNECT`].
const REST: Duration = Duration::from_secs(300);

/// Reads at URLs, and its connections.
#[derive(Debug, Default)]
pub struct UrlReader {
    http: OnceLock<Option<Client>>,
    /// When the reader was closed.
    closed: Mutex<Option<Instant>>,
}

/// A file that is being read: what has arrived, and its digest.
#[derive(Debug)]
pub struct Part {
    to: File,
    size: u64,
    hasher: blake3::Hasher,
}

/// The failure of a read: of the store, or of the disk.
enum Failure {
    Store(String),
    Disk(std::io::Error),
}

impl From<reqwest::Error> for Failure {
    /// Without the URL, which is a secret.
    fn from(error: reqwest::Error) -> Self {
        let error = error.without_url();
        let causes = successors(Some(&error as &dyn std::error::Error), |cause| cause.source());
        Self::Store(causes.map(ToString::to_string).collect::<Vec<_>>().join(": "))
    }
}

impl From<std::io::Error> for Failure {
    fn from(error: std::io::Error) -> Self {
        Self::Disk(error)
    }
}

impl Part {
    /// The beginning of a read of `size` bytes into the empty file `to`.
    pub fn new(to: File, size: u64) -> Self {
        Self { to, size, hasher: blake3::Hasher::new() }
    }

    /// The digest of what has arrived.
    pub fn digest(&self) -> BlobId {
        self.hasher.finalize().into()
    }

    fn add(&mut self, piece: &[u8]) -> std::result::Result<(), Failure> {
        if self.hasher.count() + piece.len() as u64 > self.size {
            return Err(Failure::Store(format!("more than the {} bytes of the object arrived", self.size)));
        }
        self.to.write_all(piece)?;
        self.hasher.update(piece);
        Ok(())
    }

    fn restart(&mut self) -> std::io::Result<()> {
        self.hasher.reset();
        self.to.set_len(0)?;
        self.to.rewind()
    }
}

impl UrlReader {
    /// Whether a read is worth an attempt: the reader was not closed a short time ago.
    pub fn is_open(&self) -> bool {
        let closed = self.closed.lock().unwrap_or_else(PoisonError::into_inner);
        closed.is_none_or(|closed| closed.elapsed() >= REST)
    }

    /// Closes the reader for some minutes, because the bucket cannot be reached.
    pub fn close(&self) {
        *self.closed.lock().unwrap_or_else(PoisonError::into_inner) = Some(Instant::now());
    }

    /// Reads the rest of a file. The inner error is of the store: the part has what arrived before, and another URL may
    /// return the rest. The caller compares the digest.
    ///
    /// # Errors
    /// Unavailable (inner) when the store refuses the URL, cannot be reached, or sends another number of bytes; Internal or
    /// Exhausted when the disk fails.
    pub fn read(&self, url: &Secret, mut part: Part) -> Result<(Part, Result<()>)> {
        let http = self.http.get_or_init(http).clone();
        let http = http.ok_or_else(|| Error::internal("reading an object at its URL", "no HTTP client was made"))?;
        let url = url.clone();
        let (part, received) = wait(async move {
            let received = receive(&http, &url, &mut part).await;
            (part, received)
        })?;
        match received {
            Ok(()) => Ok((part, Ok(()))),
            Err(Failure::Disk(error)) => Err(Error::internal("writing an object", error)),
            Err(Failure::Store(reason)) => {
                let message = format!("the blob store did not return an object at its signed URL: {reason}");
                Ok((part, Err(Error::unavailable(message))))
            }
        }
    }
}

async fn receive(http: &Client, url: &Secret, part: &mut Part) -> std::result::Result<(), Failure> {
    let begun = part.hasher.count();
    let mut request = http.get(url.reveal());
    if begun > 0 {
        request = request.header(RANGE, format!("bytes={begun}-"));
    }
    let mut response = request.send().await?;
    match response.status() {
        StatusCode::PARTIAL_CONTENT if begun > 0 => {}
        // A store may ignore the range.
        StatusCode::OK => part.restart()?,
        status => return Err(Failure::Store(format!("the answer was {status}"))),
    }
    while let Some(piece) = response.chunk().await? {
        part.add(&piece)?;
    }
    match part.hasher.count() {
        count if count == part.size => Ok(()),
        count => Err(Failure::Store(format!("{count} of {} bytes arrived", part.size))),
    }
}

/// A client that follows no redirect: a signed URL is of its host alone.
fn http() -> Option<Client> {
    // An earlier provider of this process stays.
    let _ = rustls::crypto::ring::default_provider().install_default();
    Client::builder().redirect(Policy::none()).connect_timeout(CONNECT).read_timeout(SILENCE).build().ok()
}

#[cfg(test)]
mod tests;
