//! Attempts of a job: the credentials of one, its end, and the state that follows.

use super::{id::JobId, job::JobState};

/// One attempt of a job, and the proof that its worker presents.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Attempt {
    /// The job.
    pub job_id: JobId,
    /// BLAKE3 of the secret part of the attempt's token, hex.
    pub token_hash: String,
}

/// The end of an attempt without a result.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum AttemptEnd {
    /// The server stopped it, or crashed: no fault of the job, so the attempt does not count.
    Stopped,
    /// The machine or the cluster ended it: no fault of the job, so the attempt does not count. Holds the reason.
    Interrupted(String),
    /// Another attempt could help, such as after a crash of the worker. Holds the reason.
    Broken(String),
    /// No attempt can help, such as with input that cannot be learned from. Holds the reason.
    Permanent(String),
}

/// The values of a job that decide its next state.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Standing {
    /// The attempt that ended, from 1.
    pub attempt: u32,
    /// Most attempts of the job.
    pub max_attempts: u32,
    /// The step from which the next attempt would resume.
    pub checkpoint_step: Option<u64>,
    /// Whether a cancellation was requested.
    pub cancel_requested: bool,
}

/// A job's state after an attempt.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Next {
    /// Queued, failed or cancelled.
    pub state: JobState,
    /// Attempts used so far.
    pub attempt: u32,
    /// Progress message of the job.
    pub message: String,
    /// Reason for the failure; empty if the job did not fail.
    pub error: String,
}

impl AttemptEnd {
    /// The retry rule.
    pub fn next(&self, standing: Standing) -> Next {
        let Standing { attempt, max_attempts, checkpoint_step, cancel_requested } = standing;
        let over = |state, message: String, error: String| Next { state, attempt, message, error };
        let again = |used: u32, what: &str| {
            let how = match checkpoint_step {
                Some(step) => format!("resumes from step {step}"),
                None => "starts from the beginning".to_owned(),
            };
            Next {
                state: JobState::Queued,
                attempt: used,
                message: format!("{what}; attempt {} of {max_attempts} {how}", used + 1),
                error: String::new(),
            }
        };
        if cancel_requested {
            return over(JobState::Cancelled, "cancelled".to_owned(), String::new());
        }
        match self {
            Self::Stopped => again(attempt.saturating_sub(1), "the server had to stop it"),
            Self::Interrupted(what) => again(attempt.saturating_sub(1), what),
            Self::Broken(what) if attempt < max_attempts => again(attempt, what),
            Self::Broken(what) => over(
                JobState::Failed,
                "failed".to_owned(),
                format!("{what}; that was attempt {attempt} of {max_attempts}"),
            ),
            Self::Permanent(what) => over(JobState::Failed, "failed".to_owned(), what.clone()),
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const SECOND_OF_THREE: Standing =
        Standing { attempt: 2, max_attempts: 3, checkpoint_step: Some(400), cancel_requested: false };

    fn killed() -> AttemptEnd {
        AttemptEnd::Broken("the worker was killed by signal 9".to_owned())
    }

    #[test]
    fn a_crash_uses_up_an_attempt_and_names_the_next_start() {
        let next = killed().next(SECOND_OF_THREE);
        assert_eq!((next.state, next.attempt), (JobState::Queued, 2));
        assert_eq!(next.message, "the worker was killed by signal 9; attempt 3 of 3 resumes from step 400");
        let fresh = killed().next(Standing { checkpoint_step: None, ..SECOND_OF_THREE });
        assert!(fresh.message.ends_with("attempt 3 of 3 starts from the beginning"), "{}", fresh.message);
    }

    #[test]
    fn the_last_crash_fails_the_job() {
        let next = killed().next(Standing { attempt: 3, ..SECOND_OF_THREE });
        assert_eq!(next.state, JobState::Failed);
        assert_eq!(next.error, "the worker was killed by signal 9; that was attempt 3 of 3");
    }

    #[test]
    fn a_stopped_server_or_a_lost_machine_costs_no_attempt() {
        let next = AttemptEnd::Stopped.next(Standing { attempt: 3, ..SECOND_OF_THREE });
        assert_eq!((next.state, next.attempt), (JobState::Queued, 2));
        let lost = AttemptEnd::Interrupted("node1 failed".to_owned()).next(Standing { attempt: 3, ..SECOND_OF_THREE });
        assert_eq!((lost.state, lost.attempt), (JobState::Queued, 2));
        assert_eq!(lost.message, "node1 failed; attempt 3 of 3 resumes from step 400");
    }

    #[test]
    fn invalid_input_fails_without_a_retry_and_a_cancel_takes_precedence() {
        let wrong = AttemptEnd::Permanent("episode ep_1: action is not finite".to_owned());
        assert_eq!(wrong.next(Standing { attempt: 1, ..SECOND_OF_THREE }).state, JobState::Failed);
        for end in [AttemptEnd::Stopped, killed(), wrong] {
            let next = end.next(Standing { cancel_requested: true, ..SECOND_OF_THREE });
            assert_eq!((next.state, next.error.as_str()), (JobState::Cancelled, ""));
        }
    }

    proptest! {
        /// For any sequence of attempt ends, each move is legal and the number of attempts stays within the job's
        /// limit.
        #[test]
        fn a_job_has_at_most_its_maximum_of_attempts(
            max_attempts in 1..6_u32,
            ends in proptest::collection::vec((0..4_u8, prop::bool::weighted(0.1)), 1..40),
        ) {
            let (mut state, mut used) = (JobState::Queued, 0);
            for (end, cancel_requested) in ends {
                if state.ended() {
                    break;
                }
                prop_assert!(state.may_become(JobState::Running));
                let attempt = used + 1;
                prop_assert!(attempt <= max_attempts);
                let end = match end {
                    0 => AttemptEnd::Stopped,
                    1 => killed(),
                    2 => AttemptEnd::Interrupted("the node failed".to_owned()),
                    _ => AttemptEnd::Permanent("wrong".to_owned()),
                };
                let next = end.next(Standing { attempt, max_attempts, checkpoint_step: None, cancel_requested });
                prop_assert!(JobState::Running.may_become(next.state));
                prop_assert_eq!(next.state == JobState::Failed, !next.error.is_empty());
                prop_assert!(next.attempt <= attempt);
                (state, used) = (next.state, next.attempt);
            }
        }
    }
}
