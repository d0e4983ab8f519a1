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
    /// Replaces the waiting observation; true when it was never taken. Its steps are then skipped steps of the new one.
    pub(super) fn put(&self, mut observation: Observation) -> bool {
        let mut waiting = self.lock();
        let passed_over = waiting.take();
        if let Some(passed_over) = &passed_over {
            let steps = passed_over.skipped_steps.saturating_add(1);
            observation.skipped_steps = observation.skipped_steps.saturating_add(steps);
        }
        *waiting = Some(observation);
        drop(waiting);
        self.filled.notify_one();
        passed_over.is_some()
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

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn the_steps_of_replaced_observations_are_skipped_steps_of_the_next() {
        let latest = Latest::default();
        let observation = |stamp_ns, skipped_steps| Observation { stamp_ns, skipped_steps, ..Observation::default() };
        assert!(!latest.put(observation(1, 0)));
        assert!(latest.put(observation(2, 3)) && latest.put(observation(3, 0)));
        // Two were replaced, and the robot missed three ticks before the second.
        assert_eq!(latest.take().await, observation(3, 5));
        assert!(!latest.put(observation(4, 0)));
        assert_eq!(latest.take().await.skipped_steps, 0);
    }
}
