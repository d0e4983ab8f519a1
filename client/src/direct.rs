//! Files straight from the server's bucket, by the URLs that the server signs. What fails here is read through the server
//! instead, so nothing here is an error of the caller.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use bytes::Bytes;
use futures::Stream;
use futures::stream::try_unfold;

use crate::error::{ClientError, Result};

// The bucket may be of a network that this machine is not in.
const CONNECT: Duration = Duration::from_secs(3);
// Without a byte for so long, the server is asked instead.
const SILENCE: Duration = Duration::from_secs(20);

/// The way to the bucket. Clones share it, and its connections.
#[derive(Clone, Debug)]
pub(crate) struct Direct {
    /// Whether the connection to the server is encrypted: then what the bucket sends must be, too.
    is_encrypted: bool,
    http: Arc<OnceLock<Option<reqwest::Client>>>,
    has_failed: Arc<AtomicBool>,
}

impl Direct {
    pub(crate) fn new(is_encrypted: bool) -> Self {
        Self { is_encrypted, http: Arc::default(), has_failed: Arc::default() }
    }

    /// Whether the bucket is worth a try: nothing from it has failed yet.
    pub(crate) fn is_open(&self) -> bool {
        !self.has_failed.load(Ordering::Relaxed)
    }

    /// Reads everything through the server from now on.
    pub(crate) fn close(&self) {
        self.has_failed.store(true, Ordering::Relaxed);
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
