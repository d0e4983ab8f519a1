//! Retries over a broken connection: growing pauses and a limit.

use std::time::Duration;

use crate::error::Result;

/// The remaining retries of calls that are safe to repeat.
#[derive(Debug)]
pub(crate) struct Backoff {
    failures: u32,
    endless: bool,
}

// 0.1 + 0.2 + 0.4 + ... + 6.4 s: about 13 s, in which a server can restart.
const TRIES: u32 = 7;
// Endless retries pause for at most 1.6 s, so that a server is soon found again.
const LONGEST: u32 = 4;

impl Backoff {
    pub(crate) fn new() -> Self {
        Self { failures: 0, endless: false }
    }

    /// Without a limit; the caller decides when to give up.
    pub(crate) fn endless() -> Self {
        Self { failures: 0, endless: true }
    }

    /// Progress was made: the count starts again.
    pub(crate) fn restore(&mut self) {
        self.failures = 0;
    }

    /// The pause before the next try; `None` when it is time to give up.
    pub(crate) fn next_wait(&mut self) -> Option<Duration> {
        let wait = Duration::from_millis(100 << self.failures.min(if self.endless { LONGEST } else { TRIES }));
        self.failures = self.failures.saturating_add(1);
        (self.endless || self.failures <= TRIES).then_some(wait)
    }
}

/// Makes a call that is safe to repeat, and retries it while there is no connection.
///
/// # Errors
/// Those of the call that no retry can help, or its last one once retries are exhausted.
pub(crate) async fn patiently<T>(call: impl AsyncFn() -> Result<T>) -> Result<T> {
    let mut backoff = Backoff::new();
    loop {
        match call().await {
            Err(error) if error.is_transient() => match backoff.next_wait() {
                Some(wait) => tokio::time::sleep(wait).await,
                None => return Err(error),
            },
            ended => return ended,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pauses_grow_end_and_start_again_after_progress() {
        let mut backoff = Backoff::new();
        let waits: Vec<u128> = std::iter::from_fn(|| backoff.next_wait()).map(|wait| wait.as_millis()).collect();
        assert_eq!(waits, [100, 200, 400, 800, 1600, 3200, 6400]);
        assert_eq!(backoff.next_wait(), None);
        backoff.restore();
        assert_eq!(backoff.next_wait(), Some(Duration::from_millis(100)));
    }

    #[test]
    fn endless_pauses_grow_to_a_bound() {
        let mut backoff = Backoff::endless();
        let waits: Vec<u128> = (0..7).filter_map(|_| backoff.next_wait()).map(|wait| wait.as_millis()).collect();
        assert_eq!(waits, [100, 200, 400, 800, 1600, 1600, 1600]);
    }
}
