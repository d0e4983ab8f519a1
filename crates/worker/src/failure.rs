//! The reasons for which a job's work ends without a result, and whether another attempt could help.

use gleaner_group::GroupError;
use gleaner_learn::LearnError;
use gleaner_recording::RecordingError;

use gleaner_core::error::{Error, Kind};

/// Reason for a missing result.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub(crate) enum Failure {
    /// The server requested a stop.
    #[error("cancelled")]
    Cancelled,
    /// The input or the settings are wrong: every attempt would fail in the same way.
    #[error("{0}")]
    Permanent(String),
    /// Another rank of this attempt is lost, and its engine knows the reason.
    #[error("{0}")]
    Lost(String),
    /// Memory, disk, threads or a defect: another attempt may succeed.
    #[error("{0}")]
    Retryable(String),
}

impl From<LearnError> for Failure {
    fn from(error: LearnError) -> Self {
        let message = error.to_string();
        match error {
            LearnError::Cancelled => Self::Cancelled,
            LearnError::Invalid { .. }
            | LearnError::Checkpoint(_)
            | LearnError::Version { .. }
            | LearnError::Diverged { .. } => Self::Permanent(message),
            LearnError::Group(_) => Self::Lost(message),
            LearnError::Monitor { .. }
            | LearnError::Steps { .. }
            | LearnError::Thread(_)
            | LearnError::Exchange
            | LearnError::Torch(_) => Self::Retryable(message),
        }
    }
}

impl From<GroupError> for Failure {
    fn from(error: GroupError) -> Self {
        Self::Lost(error.to_string())
    }
}

impl From<Error> for Failure {
    fn from(error: Error) -> Self {
        let message = error.to_string();
        match error.kind() {
            Kind::Invalid | Kind::Precondition => Self::Permanent(message),
            Kind::Cancelled => Self::Cancelled,
            Kind::Unauthenticated
            | Kind::Forbidden
            | Kind::NotFound
            | Kind::Exists
            | Kind::Exhausted
            | Kind::Late
            | Kind::Unavailable
            | Kind::Damaged
            | Kind::Internal => Self::Retryable(message),
        }
    }
}

impl Failure {
    /// The same failure, with the episode to which it belongs.
    pub(crate) fn of_episode(self, episode: &str) -> Self {
        let named = |message| format!("episode {episode}: {message}");
        match self {
            Self::Cancelled => Self::Cancelled,
            Self::Permanent(message) => Self::Permanent(named(message)),
            Self::Lost(message) => Self::Lost(named(message)),
            Self::Retryable(message) => Self::Retryable(named(message)),
        }
    }

    /// The failure of an unusable recording of `episode`.
    pub(crate) fn recording(episode: &str, error: &RecordingError) -> Self {
        let message = format!("episode {episode}: {error}");
        if error.io_source().is_some() { Self::Retryable(message) } else { Self::Permanent(message) }
    }
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use gleaner_recording::EpisodeWriter;

    use super::*;

    #[test]
    fn a_disk_that_fills_while_a_recording_is_written_is_a_reason_to_try_again() {
        let task = gleaner_sim::task_spec(gleaner_sim::Task::PickCube, &gleaner_sim::SimConfig::default());
        let mut room = [0_u8; 16];
        let written = EpisodeWriter::create(Cursor::new(&mut room[..]), &task).and_then(EpisodeWriter::finish);
        let failure = Failure::recording("ep_1", &written.err().unwrap());
        assert!(matches!(&failure, Failure::Retryable(message) if message.contains("ep_1: writing")), "{failure:?}");
        let empty = RecordingError::Empty { path: "a.mcap".into() };
        assert!(matches!(Failure::recording("ep_1", &empty), Failure::Permanent(_)));
    }

    #[test]
    fn only_transient_failures_are_retried() {
        let diverged = Failure::from(LearnError::Diverged { step: 3 });
        assert!(matches!(&diverged, Failure::Permanent(message) if message.contains("step 3")), "{diverged:?}");
        let memory = Failure::from(LearnError::Torch("not enough memory".into()));
        assert_eq!(memory, Failure::Retryable("tensor library: not enough memory".into()));
        let threads = Failure::from(LearnError::Thread(std::io::ErrorKind::WouldBlock.into()));
        assert!(matches!(&threads, Failure::Retryable(message) if message.contains("run fewer jobs")), "{threads:?}");
        assert_eq!(Failure::from(LearnError::Cancelled), Failure::Cancelled);
        assert!(matches!(Failure::from(Error::invalid("task", "is wrong")), Failure::Permanent(_)));
        assert!(matches!(Failure::from(Error::internal("reading", "disk")), Failure::Retryable(_)));
    }
}
