//! Progress of work in units, such as segments. Independent of what is done.

use std::time::Instant;

use crate::error::LearnError;
use crate::train::Monitor;

/// The metric of segments for each second.
pub(crate) const SEGMENTS: &str = "segments_per_second";

/// Counts units that are done, reports them to the monitor, and checks for cancellation.
pub(crate) struct Progress<'a> {
    monitor: &'a mut dyn Monitor,
    total: u64,
    done: u64,
    begin: Instant,
    /// The metric of units for each second.
    rate: Option<&'static str>,
}

impl<'a> Progress<'a> {
    pub(crate) fn new(monitor: &'a mut dyn Monitor, total: u64, rate: Option<&'static str>) -> Self {
        Self { monitor, total, done: 0, begin: Instant::now(), rate }
    }

    /// Progress in segments.
    pub(crate) fn of_segments(monitor: &'a mut dyn Monitor, total: u64) -> Self {
        Self::new(monitor, total, Some(SEGMENTS))
    }

    pub(crate) fn advance(&mut self, units: usize) -> Result<(), LearnError> {
        if self.cancelled() {
            return Err(LearnError::Cancelled);
        }
        self.report(units as u64);
        Ok(())
    }

    /// Counts all units that are left.
    pub(crate) fn finish(&mut self) -> Result<(), LearnError> {
        self.advance(usize::try_from(self.total - self.done).unwrap_or(usize::MAX))
    }

    pub(crate) fn cancelled(&self) -> bool {
        self.monitor.cancelled()
    }

    pub(crate) fn report(&mut self, units: u64) {
        self.done += units;
        #[expect(clippy::cast_precision_loss, reason = "a rate for people to read")]
        let speed = self.done as f64 / self.begin.elapsed().as_secs_f64().max(1e-9);
        let metric = self.rate.map(|rate| (rate, speed));
        self.monitor.progress(self.done, self.total, metric.as_slice());
    }
}
