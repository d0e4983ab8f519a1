//! A running session, as the pages show it.

use std::collections::VecDeque;

use super::{
    id::{PolicyId, SessionId, TaskId},
    observation::CameraFrame,
    score::SegmentScored,
    time::Millis,
};

/// What is fixed when a session opens.
#[derive(Debug, Clone)]
pub struct LiveSession {
    /// Its id.
    pub id: SessionId,
    /// The name it was opened on.
    pub deployment: String,
    /// The policy that acts.
    pub policy_id: PolicyId,
    /// The task.
    pub task_id: TaskId,
    /// When it was opened.
    pub since: Millis,
    /// Whether it is stored as an episode.
    pub recorded: bool,
}

/// The current state of a session.
#[derive(Debug, Clone, Default)]
pub struct SessionState {
    /// The last image of each camera, as received.
    pub cameras: Vec<CameraFrame>,
    /// When the last images arrived.
    pub seen_at: Option<Millis>,
    /// The newest scored segment.
    pub score: Option<SegmentScored>,
    /// Number of observations answered.
    pub answered: u64,
    /// Microseconds from arrival to answer, of the newest answers.
    pub total_us: VecDeque<u64>,
}

impl SessionState {
    /// The quantile `part` of the newest response times, in microseconds; `None` without answers.
    #[expect(clippy::cast_precision_loss, reason = "a few hundred")]
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a part of a length")]
    pub fn quantile_us(&self, part: f64) -> Option<u64> {
        let mut times: Vec<u64> = self.total_us.iter().copied().collect();
        times.sort_unstable();
        times.get(((times.len() as f64 * part).ceil() as usize).saturating_sub(1)).copied()
    }
}
