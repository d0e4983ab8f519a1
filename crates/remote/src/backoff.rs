//! Attempts to reach a server that does not answer: at growing intervals, and calls between them fail at once.

use std::{
    sync::{Mutex, MutexGuard, PoisonError},
    time::Duration,
};

use gleaner_core::{Error, Result, error::Kind};
use tokio::time::Instant;

/// The first and the longest interval between attempts.
const FIRST: Duration = Duration::from_millis(250);
const LONGEST: Duration = Duration::from_secs(8);

/// The state of one server, shared by its sessions.
#[derive(Debug, Default)]
pub(crate) struct Backoff(Mutex<State>);

#[derive(Debug, Default)]
struct State {
    failures: u32,
    /// Until then, calls fail with `reason`.
    until: Option<Instant>,
    reason: String,
}

impl State {
    /// Whether the next attempt is not due yet.
    fn is_waiting(&self) -> bool {
        self.until.is_some_and(|until| Instant::now() < until)
    }
}

impl Backoff {
    /// Admits a call.
    ///
    /// # Errors
    /// Unavailable with the reason of the last failure, until the next attempt is due.
    pub(crate) fn admit(&self) -> Result<()> {
        let state = self.state();
        if state.is_waiting() { Err(Error::unavailable(state.reason.clone())) } else { Ok(()) }
    }

    /// Notes the result of a call. An answer that cannot be used is an answer.
    pub(crate) fn note<T>(&self, server: &str, result: &Result<T>) {
        let mut state = self.state();
        match result {
            // Several calls that fail together are one failure.
            Err(error) if error.kind() == Kind::Unavailable && state.is_waiting() => {}
            Err(error) if error.kind() == Kind::Unavailable => {
                if state.failures == 0 {
                    tracing::warn!(%error, server, "a policy's server does not answer");
                }
                let interval = LONGEST.min(FIRST.saturating_mul(2_u32.saturating_pow(state.failures)));
                state.failures = state.failures.saturating_add(1);
                state.until = Some(Instant::now() + interval);
                error.message().clone_into(&mut state.reason);
            }
            Ok(_) | Err(_) => {
                if state.failures > 0 {
                    tracing::info!(server, "a policy's server answers again");
                }
                *state = State::default();
            }
        }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test(start_paused = true)]
    async fn attempts_are_made_at_growing_intervals() {
        let backoff = Backoff::default();
        let fail = || backoff.note::<()>("x", &Err(Error::unavailable("gone")));
        assert!(backoff.admit().is_ok());
        for interval in [250, 500, 1000, 2000, 4000, 8000, 8000, 8000] {
            fail();
            assert_eq!(backoff.admit().unwrap_err().message(), "gone");
            tokio::time::advance(Duration::from_millis(interval - 1)).await;
            assert!(backoff.admit().is_err(), "{interval}");
            tokio::time::advance(Duration::from_millis(1)).await;
            assert!(backoff.admit().is_ok(), "{interval}");
        }
        fail();
        backoff.note("x", &Ok(()));
        assert!(backoff.admit().is_ok());
        backoff.note::<()>("x", &Err(Error::precondition("wrong actions")));
        assert!(backoff.admit().is_ok(), "it answers");
    }
}
