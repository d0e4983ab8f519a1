//! A reply that a session owes its robot, perhaps with a deadline.

use std::{sync::Arc, time::Duration};

use tokio::time::Instant;

use super::stages::Stages;
use crate::domain::observation::{Observation, SessionOutput};

/// A pending reply to one observation.
#[derive(Debug, Clone)]
pub(super) struct PendingReply {
    /// The stamp of the observation.
    pub(super) stamp_ns: i64,
    /// The number of observations dropped in favour of this one.
    pub(super) dropped: u64,
    pub(super) stages: Arc<Stages>,
    /// `None`: no deadline.
    pub(super) deadline: Option<std::time::Instant>,
}

impl PendingReply {
    /// For an observation that arrives now; `otherwise` applies where it has no deadline of its own.
    pub(super) fn for_observation(observation: &Observation, otherwise: Option<Duration>, dropped: u64) -> Self {
        let stages = Arc::new(Stages::begin());
        let deadline = observation.deadline.or(otherwise).map(|within| stages.arrived() + within);
        Self { stamp_ns: observation.stamp_ns, dropped, stages, deadline }
    }

    /// Whether the deadline has passed.
    pub(super) fn is_late(&self) -> bool {
        self.deadline.is_some_and(|deadline| deadline <= std::time::Instant::now())
    }

    /// The output in place of an action; `reason` is another cause than time, or empty.
    pub(super) fn missed(self, reason: String) -> SessionOutput {
        SessionOutput::Missed { stamp_ns: self.stamp_ns, dropped: self.dropped, timings: self.stages.timings(), reason }
    }
}

/// Completes at the deadline of a reply; never without a reply or a deadline.
pub(super) async fn late(reply: Option<&PendingReply>) {
    passed(reply.and_then(|reply| reply.deadline).map(Instant::from_std)).await;
}

/// Completes at this time, or never.
pub(super) async fn passed(time: Option<Instant>) {
    match time {
        Some(time) => tokio::time::sleep_until(time).await,
        None => std::future::pending().await,
    }
}
