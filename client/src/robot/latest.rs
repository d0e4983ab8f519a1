//! A place for the latest observation, between the loop and the session task. Putting never waits.

use std::sync::{Mutex, MutexGuard, PoisonError};

use gleaner_proto::v1::Observation;
use tokio::sync::Notify;

/// Room for one observation.
#[derive(Debug, Default)]
pub(super) struct Latest {
    waiting: Mutex<Option<Observation>>,
    filled: Notify,
}

impl Latest {
    /// Replaces the waiting observation; true when it was never taken.
    pub(super) fn put(&self, observation: Observation) -> bool {
        let passed_over = self.lock().replace(observation).is_some();
        self.filled.notify_one();
        passed_over
    }

    /// Waits for an observation and takes it. Cancel-safe: dropping the future loses no observation.
    pub(super) async fn take(&self) -> Observation {
        loop {
            if let Some(observation) = self.lock().take() {
                return observation;
            }
            self.filled.notified().await;
        }
    }

    // Whole after every statement, so a panic elsewhere does not spoil it.
    fn lock(&self) -> MutexGuard<'_, Option<Observation>> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
