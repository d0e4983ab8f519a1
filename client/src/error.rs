//! The errors of the client library, each with its fix.
//!
//! Must not know commands, and prints nothing.

use std::path::PathBuf;

use gleaner_proto::v1::{Job, JobState};
use gleaner_recording::RecordingError;

use crate::reason;

/// The result of every call of this library.
pub type Result<T> = std::result::Result<T, ClientError>;

/// Why a call failed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ClientError {
    /// The server is unreachable at that address.
    #[error("cannot reach {url}: {problem}; is the server running there (gleaner-server serve)?")]
    Connect {
        /// The address.
        url: String,
        /// The transport's message.
        problem: String,
    },
    /// The server rejected the call. The message is the server's own and names the fix.
    #[error("{}", describe(.0))]
    Rejected(Box<tonic::Status>),
    /// The file system reported an error.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// An argument is invalid.
    #[error("{0}")]
    Invalid(String),
    /// A recording or a task specification is invalid.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// Received bytes differ from the announced digest.
    #[error("{what}: expected BLAKE3 {expected}, got {found}: the download is damaged; download it again")]
    Damaged {
        /// What was fetched.
        what: String,
        /// Digest expected, hex.
        expected: String,
        /// Digest found, hex.
        found: String,
    },
    /// The server violated the contract of its API.
    #[error("the server answered without {missing}; client and server may be of different versions")]
    Contract {
        /// The part missing from the answer.
        missing: &'static str,
    },
    /// A session ended without a close.
    #[error("the session was lost: {0}; is the server still running?")]
    SessionLost(String),
    /// The server did not answer an observation by its deadline. The session continues.
    #[error("the observation of stamp {stamp_ns} got no action by its deadline ({waited_us} µs){}; send the next one", because(.reason))]
    Missed {
        /// The observation's stamp.
        stamp_ns: i64,
        /// How long the server had it, in microseconds; 0 when the server did not report it.
        waited_us: u64,
        /// Another cause than time, as the server reported it; empty otherwise.
        reason: String,
    },
    /// A job ended without success.
    #[error("{}", describe_job(.0))]
    JobEnded(Box<Job>),
}

impl ClientError {
    /// An [`ClientError::Io`] that names the path.
    pub fn io(path: impl Into<PathBuf>) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.into();
        move |source| Self::Io { path, source }
    }

    /// The server's status code, when the server rejected the call.
    #[must_use]
    pub fn code(&self) -> Option<tonic::Code> {
        if let Self::Rejected(status) = self { Some(status.code()) } else { None }
    }

    /// Whether a retry a little later may succeed: the connection broke, or the server is starting or stopping.
    #[must_use]
    pub fn is_transient(&self) -> bool {
        match self {
            Self::Connect { .. } | Self::SessionLost(_) | Self::Missed { .. } => true,
            Self::Rejected(status) => is_transient(status),
            Self::Io { .. }
            | Self::Invalid(_)
            | Self::Recording(_)
            | Self::Damaged { .. }
            | Self::Contract { .. }
            | Self::JobEnded(_) => false,
        }
    }
}

impl From<tonic::Status> for ClientError {
    fn from(status: tonic::Status) -> Self {
        Self::Rejected(Box::new(status))
    }
}

// A broken connection arrives as Unavailable, Unknown, Internal or Cancelled with the transport's error as its source.
// A status that the server itself sent has no source.
fn is_transient(status: &tonic::Status) -> bool {
    match std::error::Error::source(status) {
        Some(source) => !reason::is_lasting(source),
        None => status.code() == tonic::Code::Unavailable,
    }
}

fn describe(status: &tonic::Status) -> String {
    let message = status.message();
    match (message.is_empty(), std::error::Error::source(status)) {
        (_, Some(source)) if reason::is_lasting(source) => {
            format!("cannot connect to the server: {}", reason::reason(source))
        }
        (_, Some(source)) => {
            format!("the connection to the server broke ({}); is it still running? try again", reason::reason(source))
        }
        (false, None) => message.to_owned(),
        (true, None) => format!("the server rejected the call: {}", status.code().description()),
    }
}

fn because(reason: &str) -> String {
    if reason.is_empty() { String::new() } else { format!(": {reason}") }
}

fn describe_job(job: &Job) -> String {
    match job.state() {
        JobState::Failed => format!("job {} failed: {}", job.id, job.error),
        JobState::Cancelled => format!("job {} was cancelled", job.id),
        JobState::Unspecified | JobState::Queued | JobState::Running | JobState::Succeeded => {
            format!("job {} ended in an unexpected state ({})", job.id, job.state().as_str_name())
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_servers_message_is_passed_on_unchanged() {
        let error = ClientError::from(tonic::Status::invalid_argument("beta: 1.5 is outside [0, 1]"));
        assert_eq!(error.to_string(), "beta: 1.5 is outside [0, 1]");
        assert!(!error.is_transient());
        assert_eq!(error.code(), Some(tonic::Code::InvalidArgument));
    }

    #[test]
    fn a_broken_connection_is_transient_and_a_server_error_is_not() {
        let broken = tonic::Status::from_error(Box::new(std::io::Error::from(std::io::ErrorKind::BrokenPipe)));
        assert!(ClientError::from(broken).is_transient());
        assert!(ClientError::from(tonic::Status::unavailable("starting")).is_transient());
        assert!(!ClientError::from(tonic::Status::internal("request 7 failed")).is_transient());
    }

    #[test]
    fn a_failed_job_returns_its_error() {
        let job =
            Job { id: "job_1".into(), state: JobState::Failed.into(), error: "out of memory".into(), ..Job::default() };
        assert_eq!(ClientError::JobEnded(Box::new(job)).to_string(), "job job_1 failed: out of memory");
    }
}
