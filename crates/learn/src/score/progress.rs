//! Progress of a score run, in segments. Independent of how they are scored.

use std::time::Instant;

use crate::error::LearnError;
use crate::train::Monitor;
use crate::trajectory::Trajectory;

/// Counts scored segments, reports them to the monitor, and checks for cancellation.
pub(super) struct Progress<'a> {
    monitor: &'a mut dyn Monitor,
    total: u64,
    done: u64,
    begin: Instant,
}

impl<'a> Progress<'a> {
    pub(super) fn new(monitor: &'a mut dyn Monitor, total: u64) -> Self {
        Self { monitor, total, done: 0, begin: Instant::now() }
    }

    pub(super) fn advance(&mut self, segments: usize) -> Result<(), LearnError> {
        if self.cancelled() {
            return Err(LearnError::Cancelled);
        }
        self.report(segments as u64);
        Ok(())
    }

    /// Counts all segments that are left.
    pub(super) fn finish(&mut self) -> Result<(), LearnError> {
        self.advance(usize::try_from(self.total - self.done).unwrap_or(usize::MAX))
    }

    pub(super) fn cancelled(&self) -> bool {
        self.monitor.cancelled()
    }

    pub(super) fn report(&mut self, segments: u64) {
        self.done += segments;
        #[expect(clippy::cast_precision_loss, reason = "a rate for people to read")]
        let rate = self.done as f64 / self.begin.elapsed().as_secs_f64().max(1e-9);
        self.monitor.progress(self.done, self.total, &[("segments_per_second", rate)]);
    }
}

/// Number of segments of `episodes`.
pub(super) fn count<'a>(episodes: impl IntoIterator<Item = &'a Trajectory>) -> u64 {
    episodes.into_iter().map(|episode| episode.steps() as u64).sum()
}
