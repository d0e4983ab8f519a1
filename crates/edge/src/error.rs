//! Rejections by the edge, as values that the caller puts into messages. Must not depend on flags or status codes.

use std::{fmt, path::PathBuf, time::Duration};

/// A rejection by the edge.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum EdgeError {
    /// A client made more calls in a second than its limit.
    #[error("more than {limit} calls a second; retry in {} ms", retry_after.as_millis())]
    CallRate {
        /// Calls per second.
        limit: u32,
        /// When the next call is accepted; at least a millisecond.
        retry_after: Duration,
    },
    /// A client has reached its limit of running calls.
    #[error("{limit} calls run already; end one and retry")]
    CallsAtOnce {
        /// Calls at the same time.
        limit: usize,
    },
    /// A request stayed below the minimum rate for too long.
    #[error("the request is slower than the minimum rate")]
    SlowRequest,
    /// A certificate file cannot be used.
    #[error("{file} {}: {problem}", path.display())]
    Certificate {
        /// The kind of file.
        file: TlsFile,
        /// Its path.
        path: PathBuf,
        /// The fault of the file.
        problem: String,
    },
    /// TLS cannot be set up at all.
    #[error("setting up TLS: {0}")]
    Tls(String),
}

/// A file that TLS needs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TlsFile {
    /// The certificate chain of the server.
    Certificate,
    /// Its private key.
    Key,
    /// The authority that signs the clients' certificates.
    ClientAuthority,
}

impl fmt::Display for TlsFile {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Certificate => "certificate",
            Self::Key => "private key",
            Self::ClientAuthority => "client authority",
        })
    }
}
