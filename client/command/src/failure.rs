//! The failure of a command: one line with the fix, and the exit code.

use std::io;

use gleaner_client::ClientError;
use gleaner_recording::RecordingError;
use gleaner_sim::SimError;
use rustix::process::Signal;

/// Exit code of a command that failed.
const FAILED: u8 = 1;
/// Shells add the number of the signal that ended a program to this.
const SIGNALLED: i32 = 128;

pub(crate) type Result<T> = std::result::Result<T, Failure>;

#[derive(Debug, thiserror::Error)]
pub(crate) enum Failure {
    #[error(transparent)]
    Client(#[from] ClientError),
    #[error(transparent)]
    Sim(#[from] SimError),
    /// Writing to standard output or the terminal failed.
    #[error("output: {0}")]
    Output(#[from] io::Error),
    #[error("{0}")]
    Message(String),
    /// A signal ended the command before its work was done.
    #[error("{message}")]
    Interrupted { signal: Signal, message: &'static str },
}

impl Failure {
    pub(crate) fn message(message: impl Into<String>) -> Self {
        Self::Message(message.into())
    }

    /// The exit code of the process: for a command that was interrupted, the one that shells give a program that the signal
    /// has ended (130 for SIGINT, 143 for SIGTERM).
    pub(crate) fn exit_code(&self) -> u8 {
        match self {
            Self::Interrupted { signal, message: _ } => u8::try_from(SIGNALLED + signal.as_raw()).unwrap_or(FAILED),
            Self::Client(_) | Self::Sim(_) | Self::Output(_) | Self::Message(_) => FAILED,
        }
    }

    /// Whether an open connection broke.
    pub(crate) fn is_lost_connection(&self) -> bool {
        matches!(self, Self::Client(ClientError::Rejected(status)) if std::error::Error::source(status).is_some())
    }

    pub(crate) fn is_broken_pipe(&self) -> bool {
        matches!(self, Self::Output(error) if error.kind() == io::ErrorKind::BrokenPipe)
    }
}

impl From<tonic::Status> for Failure {
    fn from(status: tonic::Status) -> Self {
        Self::Client(status.into())
    }
}

impl From<RecordingError> for Failure {
    fn from(error: RecordingError) -> Self {
        Self::Client(error.into())
    }
}

/// A required part of an answer, or the failure that names it.
pub(crate) fn present<T>(part: Option<T>, missing: &'static str) -> Result<T> {
    part.ok_or(Failure::Client(ClientError::Contract { missing }))
}
