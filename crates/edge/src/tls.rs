//! TLS: the handshake with the current certificate files. They are read again when they change and on SIGHUP, so that a
//! certificate is renewed without a restart; open connections keep the one of their handshake. Must not depend on the
//! creation of certificates.

use std::{
    io,
    os::unix::fs::MetadataExt as _,
    path::{Path, PathBuf},
    sync::{Arc, PoisonError, RwLock},
    time::Duration,
};

use tokio::{
    io::{AsyncRead, AsyncWrite},
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

use crate::error::{EdgeError, TlsFile};

/// Interval between two checks of the files.
const CHECK_EVERY: Duration = Duration::from_secs(2);

/// A connection, encrypted or not.
pub type Transport = Either<TcpStream, TlsStream<TcpStream>>;

/// The protocol of a listener's connections.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Protocol {
    /// HTTP/1.1, for the browsers that read the pages.
    Http1,
    /// HTTP/2, which gRPC requires.
    Http2,
}

/// The files of a TLS listener, in PEM form.
#[derive(Debug, Clone)]
pub struct TlsFiles {
    /// The certificate chain of the server.
    pub certificate: PathBuf,
    /// Its private key.
    pub key: PathBuf,
    /// The authority that must have signed the clients' certificates; `None` accepts clients without one.
    pub client_authority: Option<PathBuf>,
}

/// Encryption with the current content of the files.
#[derive(Debug)]
pub struct Tls {
    files: TlsFiles,
    /// The reasons for which clients may reject a certificate (as DER), for the log.
    problems: fn(&[u8]) -> Vec<String>,
    /// The metadata of the files before they were first read.
    first: Vec<Stamp>,
    current: RwLock<Arc<ServerConfig>>,
}

/// Metadata that changes with a file and its permissions: inode, time of the last change (which programs cannot set,
/// unlike the time of writing), length.
type Stamp = Option<(u64, i64, i64, u64)>;

/// Performs a connection's handshake, if TLS is configured. The caller sets a deadline.
///
/// # Errors
/// When the peer does not complete the handshake.
pub(crate) async fn handshake(tls: Option<Arc<Tls>>, protocol: Protocol, stream: TcpStream) -> io::Result<Transport> {
    match tls {
        Some(tls) => tls.accept(protocol, stream).await.map(Either::Right),
        None => Ok(Either::Left(stream)),
    }
}

impl Tls {
    /// Reads the files. `problems` returns the reasons for which clients may reject the server's certificate (as DER);
    /// each is logged as a warning whenever a certificate is read.
    ///
    /// # Errors
    /// [`EdgeError::Certificate`] names the file that cannot be used; [`EdgeError::Tls`].
    pub fn open(files: TlsFiles, problems: fn(&[u8]) -> Vec<String>) -> Result<Self, EdgeError> {
        let first = files.stamps();
        let current = RwLock::new(Arc::new(files.read(problems)?));
        Ok(Self { files, problems, first, current })
    }

    /// Performs a connection's handshake with the current certificate. The caller sets a deadline.
    ///
    /// # Errors
    /// When the peer does not complete the handshake.
    pub async fn accept<S>(&self, protocol: Protocol, stream: S) -> io::Result<TlsStream<S>>
    where
        S: AsyncRead + AsyncWrite + Unpin,
    {
        TlsAcceptor::from(self.current(protocol)).accept(stream).await
    }

    fn current(&self, protocol: Protocol) -> Arc<ServerConfig> {
        let current = Arc::clone(&self.current.read().unwrap_or_else(PoisonError::into_inner));
        match protocol {
            Protocol::Http2 => current,
            Protocol::Http1 => {
                let mut config = ServerConfig::clone(&current);
                config.alpn_protocols = vec![b"http/1.1".to_vec()];
                Arc::new(config)
            }
        }
    }

    /// Reads the files again whenever they change and on SIGHUP, until dropped. Files that cannot be used are logged
    /// and the current certificate stays.
    pub async fn follow(&self) {
        let mut hangup = match signal(SignalKind::hangup()) {
            Ok(hangup) => Some(hangup),
            Err(error) => {
                tracing::error!(%error, "cannot listen to SIGHUP; certificates are only read again when they change");
                None
            }
        };
        let mut seen = self.first.clone();
        let mut problem: Option<String> = None;
        loop {
            let on_hangup = async {
                match &mut hangup {
                    Some(hangup) => hangup.recv().await,
                    None => std::future::pending().await,
                }
            };
            tokio::select! {
                _ = on_hangup => {}
                // An unreadable file may have become readable without a change of any file.
                () = tokio::time::sleep(CHECK_EVERY) => {
                    if problem.is_none() && self.files.stamps() == seen {
                        continue;
                    }
                }
            }
            // The metadata is recorded before the files are read, so a change during the reading is detected next time.
            seen = self.files.stamps();
            match self.files.read(self.problems) {
                Ok(fresh) => {
                    *self.current.write().unwrap_or_else(PoisonError::into_inner) = Arc::new(fresh);
                    problem = None;
                    tracing::info!(tls.cert = %self.files.certificate.display(), "the certificate was read again");
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

impl TlsFiles {
    fn read(&self, problems: fn(&[u8]) -> Vec<String>) -> Result<ServerConfig, EdgeError> {
        let chain = certificates(TlsFile::Certificate, &self.certificate)?;
        for problem in chain.first().map(|first| problems(first)).unwrap_or_default() {
            tracing::warn!(tls.cert = %self.certificate.display(), "the server's certificate: {problem}");
        }
        let key = PrivateKeyDer::from_pem_file(&self.key)
            .map_err(|error| unusable(TlsFile::Key, &self.key, format!("holds no private key in PEM form: {error}")))?;
        let provider = Arc::new(crypto::ring::default_provider());
        let builder = ServerConfig::builder_with_provider(Arc::clone(&provider))
            .with_safe_default_protocol_versions()
            .map_err(|error| EdgeError::Tls(error.to_string()))?;
        let builder = match &self.client_authority {
            None => builder.with_no_client_auth(),
            Some(path) => {
                let refused = |problem: String| unusable(TlsFile::ClientAuthority, path, problem);
                let mut roots = RootCertStore::empty();
                for root in certificates(TlsFile::ClientAuthority, path)? {
                    roots.add(root).map_err(|error| refused(error.to_string()))?;
                }
                let verifier = WebPkiClientVerifier::builder_with_provider(Arc::new(roots), provider).build();
                builder.with_client_cert_verifier(verifier.map_err(|error| refused(error.to_string()))?)
            }
        };
        let mut config = builder.with_single_cert(chain, key).map_err(|error| {
            let problem = format!("does not go with the key {}: {error}", self.key.display());
            unusable(TlsFile::Certificate, &self.certificate, problem)
        })?;
        config.alpn_protocols = vec![b"h2".to_vec()];
        Ok(config)
    }

    fn stamps(&self) -> Vec<Stamp> {
        let files = [Some(&self.certificate), Some(&self.key), self.client_authority.as_ref()];
        let stamp = |path: &PathBuf| {
            let file = std::fs::metadata(path).ok()?;
            Some((file.ino(), file.ctime(), file.ctime_nsec(), file.len()))
        };
        files.into_iter().flatten().map(stamp).collect()
    }
}

fn certificates(file: TlsFile, path: &Path) -> Result<Vec<CertificateDer<'static>>, EdgeError> {
    let read = CertificateDer::pem_file_iter(path).and_then(Iterator::collect::<Result<Vec<_>, _>>);
    match read {
        Ok(found) if found.is_empty() => Err(unusable(file, path, "holds no certificate in PEM form".to_owned())),
        Ok(found) => Ok(found),
        Err(error) => Err(unusable(file, path, error.to_string())),
    }
}

fn unusable(file: TlsFile, path: &Path, problem: String) -> EdgeError {
    EdgeError::Certificate { file, path: path.to_owned(), problem }
}

#[cfg(test)]
mod tests;
