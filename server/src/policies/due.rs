//! What a session owes its robot: an answer to one observation, perhaps by a deadline.

use std::{sync::Arc, time::Duration};

use tokio::time::Instant;

use super::stages::Stages;
use crate::domain::observation::{Observation, SessionOutput};

/// An answer that is owed.
#[derive(Debug, Clone)]
pub(super) struct Due {
    /// Of the observation.
    pub(super) stamp_ns: i64,
    /// How many were passed over for it.
    pub(super) dropped: u64,
    pub(super) stages: Arc<Stages>,
    /// `None`: whenever it is ready.
    pub(super) deadline: Option<std::time::Instant>,
}

impl Due {
    /// For an observation that comes now; `otherwise` holds where it names no deadline itself.
    pub(super) fn for_observation(observation: &Observation, otherwise: Option<Duration>, dropped: u64) -> Self {
        let stages = Arc::new(Stages::begin());
        let deadline = observation.deadline.or(otherwise).map(|within| stages.arrived() + within);
        Self { stamp_ns: observation.stamp_ns, dropped, stages, deadline }
    }

    /// Whether an answer would be late now.
    pub(super) fn is_late(&self) -> bool {
        self.deadline.is_some_and(|deadline| deadline <= std::time::Instant::now())
    }

    /// What is said instead of an answer.
    pub(super) fn missed(self) -> SessionOutput {
        SessionOutput::Missed { stamp_ns: self.stamp_ns, dropped: self.dropped, timings: self.stages.timings() }
    }
}

/// Ends when what is owed would be late; never, when nothing is owed or it has no deadline.
pub(super) async fn late(due: Option<&Due>) {
    passed(due.and_then(|due| due.deadline).map(Instant::from_std)).await;
}

/// Ends at this time, or never.
pub(super) async fn passed(time: Option<Instant>) {
    match time {
        Some(time) => tokio::time::sleep_until(time).await,
        None => std::future::pending().await,
    }
}
