//! The report of a control run, and the cause of its end.

use crate::error::ClientError;
use crate::lowest::{LowestScore, lower};

/// Counts of a run.
#[derive(Clone, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct ControlReport {
    /// The policy of the last session.
    pub policy_id: String,
    /// Ticks that ran: each observed, and acted, held or rested.
    pub ticks: u64,
    /// Ticks whose action came from the policy.
    pub acted: u64,
    /// Ticks in which the robot held because no action was due.
    pub held: u64,
    /// Ticks in which it rested: before the first action, and after it held too long.
    pub rested: u64,
    /// Times it was stopped because it held too long.
    pub stops: u64,
    /// Answers that came too late for any tick.
    pub late: u64,
    /// Observations that the server did not answer by their deadline.
    pub missed: u64,
    /// Observations replaced by a newer one, here or on the server.
    pub dropped: u64,
    /// Sessions opened after the first.
    pub reconnects: u64,
    /// Ticks skipped because the robot took longer than a period.
    pub overruns: u64,
    /// Times the server announced that it is stopping.
    pub drains: u64,
    /// The recorded and stored episodes, as far as the server could still report them.
    pub episode_ids: Vec<String>,
    /// The lowest live score, if the deployment names a score run. Its time is relative to its session.
    pub lowest: Option<LowestScore>,
}

impl ControlReport {
    /// Adds another run's counts; the policy id is the other's.
    pub fn add(&mut self, other: &Self) {
        self.policy_id.clone_from(&other.policy_id);
        self.episode_ids.extend_from_slice(&other.episode_ids);
        self.lowest = lower(self.lowest.take(), other.lowest.clone());
        let pairs = [
            (&mut self.ticks, other.ticks),
            (&mut self.acted, other.acted),
            (&mut self.held, other.held),
            (&mut self.rested, other.rested),
            (&mut self.stops, other.stops),
            (&mut self.late, other.late),
            (&mut self.missed, other.missed),
            (&mut self.dropped, other.dropped),
            (&mut self.reconnects, other.reconnects),
            (&mut self.overruns, other.overruns),
            (&mut self.drains, other.drains),
        ];
        for (count, more) in pairs {
            *count += more;
        }
    }
}

/// A failed run. The robot was stopped, unless `not_stopped` is set.
#[derive(Debug, thiserror::Error)]
#[error("{cause}{}", also(.not_stopped.as_ref()))]
pub struct ControlError<E: std::error::Error + 'static> {
    /// Why it ended.
    #[source]
    pub cause: ControlCause<E>,
    /// The robot's error when the final stop failed.
    pub not_stopped: Option<E>,
    /// The report until then.
    pub report: Box<ControlReport>,
}

/// Why a run ended.
#[derive(Debug, thiserror::Error)]
pub enum ControlCause<E: std::error::Error + 'static> {
    /// The robot failed to observe or to act.
    #[error("robot: {0}")]
    Robot(#[source] E),
    /// The run succeeded, but the final stop of the robot failed.
    #[error("the robot could not be stopped: {0}")]
    Stop(#[source] E),
    /// The policy is unusable or unreachable, or the plan or an observation is invalid.
    #[error(transparent)]
    Client(#[from] ClientError),
}

fn also<E: std::error::Error>(not_stopped: Option<&E>) -> String {
    not_stopped.map_or_else(String::new, |error| format!("; and the robot could not be stopped: {error}"))
}
