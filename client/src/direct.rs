//! Files straight from the server's bucket, by the URLs that the server signs. What fails here is read through the server
//! instead, so nothing here is an error of the caller.

use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use bytes::Bytes;
use futures::Stream;
use futures::stream::try_unfold;

use crate::error::{ClientError, Result};

// The bucket may be of a network that this machine is not in.
const CONNECT: Duration = Duration::from_secs(3);
// Without a byte for so long, the server is asked instead.
const SILENCE: Duration = Duration::from_secs(20);
// For so long after a failure, the server is asked at once: a bucket of another network costs `CONNECT` each time.
const REST: Duration = Duration::from_secs(300);

/// The way to the bucket. Clones share it, and its connections.
#[derive(Clone, Debug)]
pub(crate) struct Direct {
    /// Whether the connection to the server is encrypted: then what the bucket sends must be, too.
    is_encrypted: bool,
    http: Arc<OnceLock<Option<reqwest::Client>>>,
    rest: Duration,
    /// When something from the bucket failed last.
    failed: Arc<Mutex<Option<Instant>>>,
}

impl Direct {
    pub(crate) fn new(is_encrypted: bool) -> Self {
        Self { is_encrypted, http: Arc::default(), rest: REST, failed: Arc::default() }
    }

    /// The same with another time for which a bucket that failed is not asked.
    #[cfg(test)]
    pub(crate) fn resting(self, rest: Duration) -> Self {
        Self { rest, ..self }
    }

    /// Whether the bucket is worth a try: nothing from it has failed lately.
    pub(crate) fn is_open(&self) -> bool {
        let failed = self.failed.lock().unwrap_or_else(PoisonError::into_inner);
        failed.is_none_or(|failed| failed.elapsed() >= self.rest)
    }

    /// Reads everything through the server for a while.
    pub(crate) fn close(&self) {
        *self.failed.lock().unwrap_or_else(PoisonError::into_inner) = Some(Instant::now());
    }

    /// The bytes at a URL.
    pub(crate) async fn get(&self, url: &str) -> Result<impl Stream<Item = Result<Bytes>>> {
        if self.is_encrypted && !url.starts_with("https://") {
            return Err(failed());
        }
        let http = self.http.get_or_init(http).as_ref().ok_or_else(failed)?;
        let response = http.get(url).send().await.map_err(|_| failed())?;
        let response = response.error_for_status().map_err(|_| failed())?;
        Ok(try_unfold(response, |mut response| async move {
            let piece = response.chunk().await.map_err(|_| failed())?;
            Ok(piece.map(|piece| (piece, response)))
        }))
    }
}

/// A client that follows no redirect: a signed URL is of its host alone.
fn http() -> Option<reqwest::Client> {
    // An earlier provider of this process stays.
    let _ = rustls::crypto::ring::default_provider().install_default();
    let builder = reqwest::Client::builder().redirect(reqwest::redirect::Policy::none());
    builder.connect_timeout(CONNECT).read_timeout(SILENCE).build().ok()
}

/// Without the URL, which is a secret.
fn failed() -> ClientError {
    ClientError::Contract { missing: "the file at its URL in the bucket" }
}
