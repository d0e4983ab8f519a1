//! TLS: the handshake with what the certificate files hold now. They are read again when they change and on SIGHUP, so
//! that a certificate is renewed without a restart; connections that are open keep what they began with.

pub mod command;
mod folder;
mod issue;
mod parsed;

use std::{
    io,
    os::unix::fs::MetadataExt as _,
    path::{Path, PathBuf},
    sync::{Arc, PoisonError, RwLock},
    time::Duration,
};

use tokio::{
    net::TcpStream,
    signal::unix::{SignalKind, signal},
};
use tokio_rustls::{
    TlsAcceptor,
    rustls::{
        RootCertStore, ServerConfig, crypto,
        pki_types::{CertificateDer, PrivateKeyDer, pem::PemObject as _},
        server::WebPkiClientVerifier,
    },
    server::TlsStream,
};
use tokio_util::either::Either;

use self::parsed::Parsed;
use crate::{
    config::AccessConfig,
    error::{Error, Result},
};

/// How often the files are looked at.
const POLL_INTERVAL: Duration = Duration::from_secs(2);

/// How connections are encrypted.
#[derive(Debug)]
pub(crate) struct Tls {
    files: Files,
    /// What the files were like before they were read first.
    first: Vec<Stamp>,
    current: RwLock<Arc<ServerConfig>>,
}

/// What changes when a file or who may read it does: which one it is, when it was last changed (which no program sets, as
/// it may the time of writing), how long it is.
type Stamp = Option<(u64, i64, i64, u64)>;

/// A connection, encrypted or not.
pub(crate) type Line = Either<TcpStream, TlsStream<TcpStream>>;

/// Takes a connection through its handshake, if there is to be one.
///
/// # Errors
/// When the peer does not shake hands.
pub(crate) async fn handshake(tls: Option<Arc<Tls>>, stream: TcpStream) -> io::Result<Line> {
    match tls {
        Some(tls) => shake(tls.current(), stream).await,
        None => Ok(Either::Left(stream)),
    }
}

/// As [`handshake`], with what browsers speak instead of what calls do.
///
/// # Errors
/// When the peer does not shake hands.
pub(crate) async fn handshake_of_pages(tls: Option<Arc<Tls>>, stream: TcpStream) -> io::Result<Line> {
    let Some(tls) = tls else { return Ok(Either::Left(stream)) };
    let mut config = ServerConfig::clone(&tls.current());
    config.alpn_protocols = vec![b"http/1.1".to_vec()];
    shake(Arc::new(config), stream).await
}

#[derive(Debug)]
struct Files {
    cert: PathBuf,
    key: PathBuf,
    client_ca: Option<PathBuf>,
}

/// The handshake. Whoever calls puts a deadline around it.
async fn shake(config: Arc<ServerConfig>, stream: TcpStream) -> io::Result<Line> {
    TlsAcceptor::from(config).accept(stream).await.map(Either::Right)
}

impl Tls {
    /// Reads the files, if there are to be any.
    ///
    /// # Errors
    /// Precondition, naming the flag whose file cannot be used.
    pub(crate) fn open(config: &AccessConfig) -> Result<Option<Self>> {
        let (Some(cert), Some(key)) = (config.tls_cert.clone(), config.tls_key.clone()) else { return Ok(None) };
        let files = Files { cert, key, client_ca: config.client_ca.clone() };
        let first = files.stamps();
        let current = RwLock::new(Arc::new(files.read()?));
        Ok(Some(Self { files, first, current }))
    }

    fn current(&self) -> Arc<ServerConfig> {
        Arc::clone(&self.current.read().unwrap_or_else(PoisonError::into_inner))
    }

    /// Reads the files again whenever they change and on SIGHUP, until dropped. Files that cannot be used change nothing.
    pub(crate) async fn follow(&self) {
        let mut hangup = match signal(SignalKind::hangup()) {
            Ok(hangup) => Some(hangup),
            Err(error) => {
                tracing::error!(%error, "cannot listen to SIGHUP; certificates are read again only when they change");
                None
            }
        };
        let mut seen = self.first.clone();
        let mut problem: Option<String> = None;
        loop {
            let asked = async {
                match &mut hangup {
                    Some(hangup) => hangup.recv().await,
                    None => std::future::pending().await,
                }
            };
            tokio::select! {
                _ = asked => {}
                // What could not be read may be readable now, though no file has changed.
                () = tokio::time::sleep(POLL_INTERVAL) => {
                    if problem.is_none() && self.files.stamps() == seen {
                        continue;
                    }
                }
            }
            // Before they are read: what changes meanwhile is seen the next time.
            seen = self.files.stamps();
            match self.files.read() {
                Ok(fresh) => {
                    *self.current.write().unwrap_or_else(PoisonError::into_inner) = Arc::new(fresh);
                    problem = None;
                    tracing::info!(tls.cert = %self.files.cert.display(), "the certificate was read again");
                }
                Err(error) => {
                    let error = error.to_string();
                    if problem.as_ref() != Some(&error) {
                        tracing::error!(error, "the certificate in use stays");
                    }
                    problem = Some(error);
                }
            }
        }
    }
}

impl Files {
    fn read(&self) -> Result<ServerConfig> {
        let chain = certificates("--tls-cert", &self.cert)?;
        self.warn(&chain);
        let key = PrivateKeyDer::from_pem_file(&self.key)
            .map_err(|error| unusable("--tls-key", &self.key, format!("holds no private key in PEM form: {error}")))?;
        let provider = Arc::new(crypto::ring::default_provider());
        let builder = ServerConfig::builder_with_provider(Arc::clone(&provider))
            .with_safe_default_protocol_versions()
            .map_err(|error| Error::internal("setting up TLS", error))?;
        let builder = match &self.client_ca {
            None => builder.with_no_client_auth(),
            Some(path) => {
                let refused = |problem: String| unusable("--client-ca", path, problem);
                let mut roots = RootCertStore::empty();
                for root in certificates("--client-ca", path)? {
                    roots.add(root).map_err(|error| refused(error.to_string()))?;
                }
                let verifier = WebPkiClientVerifier::builder_with_provider(Arc::new(roots), provider).build();
                builder.with_client_cert_verifier(verifier.map_err(|error| refused(error.to_string()))?)
            }
        };
        let mut config = builder.with_single_cert(chain, key).map_err(|error| {
            unusable("--tls-cert", &self.cert, format!("does not go with the key {}: {error}", self.key.display()))
        })?;
        config.alpn_protocols = vec![b"h2".to_vec()];
        Ok(config)
    }

    /// Logs what will keep clients from accepting the server's certificate.
    fn warn(&self, chain: &[CertificateDer<'_>]) {
        let warnings = match chain.first().map(|first| Parsed::der(first)) {
            Some(Ok(parsed)) => parsed.warnings(jiff::Timestamp::now()),
            Some(Err(problem)) => vec![format!("it {problem}")],
            None => Vec::new(),
        };
        for warning in warnings {
            tracing::warn!(tls.cert = %self.cert.display(), "the server's certificate: {warning}");
        }
    }

    fn stamps(&self) -> Vec<Stamp> {
        let files = [Some(&self.cert), Some(&self.key), self.client_ca.as_ref()];
        let stamp = |path: &PathBuf| {
            let file = std::fs::metadata(path).ok()?;
            Some((file.ino(), file.ctime(), file.ctime_nsec(), file.len()))
        };
        files.into_iter().flatten().map(stamp).collect()
    }
}

fn certificates(flag: &str, path: &Path) -> Result<Vec<CertificateDer<'static>>> {
    let read = CertificateDer::pem_file_iter(path).and_then(Iterator::collect::<std::result::Result<Vec<_>, _>>);
    match read {
        Ok(found) if found.is_empty() => Err(unusable(flag, path, "holds no certificate in PEM form".to_owned())),
        Ok(found) => Ok(found),
        Err(error) => Err(unusable(flag, path, error.to_string())),
    }
}

fn unusable(flag: &str, path: &Path, problem: String) -> Error {
    Error::precondition(format!("{flag} {}: {problem}", path.display()))
}

#[cfg(test)]
mod tests;
