//! Ticks: the moments of a fixed rate, and their stamps. A tick that has passed before its turn came is skipped and
//! counted, never caught up: a robot that was late must not be hurried.

use std::time::{Duration, SystemTime};

use tokio::time::{Instant, sleep_until};

/// The beats of a fixed rate.
#[derive(Debug)]
pub(super) struct Ticks {
    period: Duration,
    /// When the next beat is meant to be.
    next: Instant,
}

/// One beat.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Tick {
    /// When it was meant to be.
    pub(super) at: Instant,
    /// Those before it that nobody was there for.
    pub(super) skipped: u32,
}

impl Ticks {
    /// The first beat is now. The period is not zero.
    pub(super) fn new(period: Duration) -> Self {
        Self { period, next: Instant::now() }
    }

    /// Waits for the next beat that has not passed yet.
    pub(super) async fn next(&mut self) -> Tick {
        let late = Instant::now().saturating_duration_since(self.next).as_nanos();
        let skipped = u32::try_from(late.div_ceil(self.period.as_nanos().max(1))).unwrap_or(u32::MAX);
        let at = self.next + self.period * skipped;
        sleep_until(at).await;
        self.next = at + self.period;
        Tick { at, skipped }
    }
}

/// Wall-clock stamps that rise as evenly as the ticks, whatever is done to the wall clock.
pub(super) struct Clock {
    begin: Instant,
    begin_ns: i64,
}

impl Clock {
    pub(super) fn new() -> Self {
        let since_1970 = SystemTime::UNIX_EPOCH.elapsed().unwrap_or_default();
        Self { begin: Instant::now(), begin_ns: i64::try_from(since_1970.as_nanos()).unwrap_or_default() }
    }

    pub(super) fn stamp_ns(&self, tick: Tick) -> i64 {
        let since = tick.at.saturating_duration_since(self.begin).as_nanos();
        self.begin_ns.saturating_add(i64::try_from(since).unwrap_or(i64::MAX))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tokio::time::advance;

    #[tokio::test(start_paused = true)]
    async fn beats_keep_their_place_and_late_ones_are_skipped() {
        let begin = Instant::now();
        let mut ticks = Ticks::new(Duration::from_millis(10));
        let mut beat = async || {
            let tick = ticks.next().await;
            assert_eq!(Instant::now(), tick.at);
            (tick.at.duration_since(begin).as_millis(), tick.skipped)
        };
        assert_eq!(beat().await, (0, 0));
        advance(Duration::from_millis(4)).await;
        assert_eq!(beat().await, (10, 0));
        advance(Duration::from_millis(10)).await;
        assert_eq!(beat().await, (20, 0));
        advance(Duration::from_millis(25)).await;
        assert_eq!(beat().await, (50, 2));
        assert_eq!(beat().await, (60, 0));
    }
}
