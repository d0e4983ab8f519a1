//! Ticks of a fixed rate, and their stamps. A missed tick is skipped and counted, never caught up: a late robot must
//! not be hurried.

use std::time::{Duration, SystemTime};

use tokio::time::{Instant, sleep_until};

/// The ticks of a fixed rate.
#[derive(Debug)]
pub(super) struct Ticks {
    period: Duration,
    /// The time of the next tick.
    next: Instant,
}

/// One tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Tick {
    /// Its scheduled time.
    pub(super) at: Instant,
    /// The number of missed ticks before it.
    pub(super) skipped: u32,
}

impl Ticks {
    /// The first tick is now. The period must not be zero.
    pub(super) fn new(period: Duration) -> Self {
        Self { period, next: Instant::now() }
    }

    /// Waits for the next tick in the future.
    pub(super) async fn next(&mut self) -> Tick {
        let late = Instant::now().saturating_duration_since(self.next).as_nanos();
        let skipped = u32::try_from(late.div_ceil(self.period.as_nanos().max(1))).unwrap_or(u32::MAX);
        let at = self.next + self.period * skipped;
        sleep_until(at).await;
        self.next = at + self.period;
        Tick { at, skipped }
    }
}

/// Wall-clock stamps that rise as evenly as the ticks, however the wall clock is set.
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
    async fn ticks_keep_their_schedule_and_missed_ones_are_skipped() {
        let begin = Instant::now();
        let mut ticks = Ticks::new(Duration::from_millis(10));
        let mut next_tick = async || {
            let tick = ticks.next().await;
            assert_eq!(Instant::now(), tick.at);
            (tick.at.duration_since(begin).as_millis(), tick.skipped)
        };
        assert_eq!(next_tick().await, (0, 0));
        advance(Duration::from_millis(4)).await;
        assert_eq!(next_tick().await, (10, 0));
        advance(Duration::from_millis(10)).await;
        assert_eq!(next_tick().await, (20, 0));
        advance(Duration::from_millis(25)).await;
        assert_eq!(next_tick().await, (50, 2));
        assert_eq!(next_tick().await, (60, 0));
    }
}
