//! The slot between the loop and the line: holds one observation, the newest. Putting never waits.

use std::sync::{Mutex, MutexGuard, PoisonError};

use gleaner_proto::v1::Observation;
use tokio::sync::Notify;

/// Room for one observation.
#[derive(Debug, Default)]
pub(super) struct Slot {
    waiting: Mutex<Option<Observation>>,
    filled: Notify,
}

impl Slot {
    /// Puts an observation in place of what is there; true when that one was never taken.
    pub(super) fn put(&self, observation: Observation) -> bool {
        let passed_over = self.lock().replace(observation).is_some();
        self.filled.notify_one();
        passed_over
    }

    /// Waits for an observation and takes it. May be dropped while it waits: nothing is lost.
    pub(super) async fn take(&self) -> Observation {
        loop {
            if let Some(observation) = self.lock().take() {
                return observation;
            }
            self.filled.notified().await;
        }
    }

    // Nothing is ever half done while it is held, so that one panicked somewhere is no matter here.
    fn lock(&self) -> MutexGuard<'_, Option<Observation>> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
