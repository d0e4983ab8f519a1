//! A least rate, as a deadline that bytes push away.

use std::time::Duration;

use tokio::time::Instant;

/// Bytes must come at a least rate; for `patience` they may come slower. Time in which nobody asks for them does not
/// count.
#[derive(Debug)]
pub(super) struct LeastRate {
    patience: Duration,
    /// How long one byte is worth.
    byte: f64,
    deadline: Instant,
    /// Since when nobody asks.
    rests_since: Option<Instant>,
    /// Bytes there were at the last look.
    seen: u64,
}

impl LeastRate {
    /// Begins at rest.
    pub(super) fn new(patience: Duration, bytes_per_second: u32, seen: u64) -> Self {
        let now = Instant::now();
        let byte = 1.0 / f64::from(bytes_per_second.max(1));
        Self { patience, byte, deadline: now + patience, rests_since: Some(now), seen }
    }

    /// Somebody waits for bytes; `received` of them have come in all. Says until when that may go on.
    pub(super) fn wait(&mut self, received: u64) -> Instant {
        let now = Instant::now();
        let rested = self.rests_since.take().map_or(Duration::ZERO, |since| now - since);
        let new = received.saturating_sub(self.seen);
        self.seen = received;
        // More bytes than a day is worth are as good as a day's.
        #[expect(clippy::cast_precision_loss, reason = "far below 2^52 bytes")]
        let worth = Duration::try_from_secs_f64((new as f64 * self.byte).min(86_400.0)).unwrap_or_default();
        self.deadline = (self.deadline + rested + worth).min(now + self.patience);
        self.deadline
    }

    /// Nobody waits any more.
    pub(super) fn rest(&mut self) {
        self.rests_since.get_or_insert_with(Instant::now);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PATIENCE: Duration = Duration::from_secs(8);

    async fn after(seconds: u64) -> Instant {
        tokio::time::advance(Duration::from_secs(seconds)).await;
        Instant::now()
    }

    #[tokio::test(start_paused = true)]
    async fn silence_is_suffered_for_a_while() {
        let begun = Instant::now();
        let mut rate = LeastRate::new(PATIENCE, 1000, 0);
        assert_eq!(rate.wait(0), begun + PATIENCE);
        after(5).await;
        assert_eq!(rate.wait(0), begun + PATIENCE, "asking again gives no more time");
    }

    #[tokio::test(start_paused = true)]
    async fn who_keeps_the_rate_goes_on_for_ever_and_who_drips_does_not() {
        let (mut good, mut drips) = (LeastRate::new(PATIENCE, 1000, 0), LeastRate::new(PATIENCE, 1000, 0));
        good.wait(0);
        drips.wait(0);
        let mut dry = None;
        for second in 1..=60 {
            let now = after(1).await;
            assert!(good.wait(second * 1000) > now);
            if drips.wait(second * 10) <= now && dry.is_none() {
                dry = Some(second);
            }
        }
        assert_eq!(dry, Some(9), "a hundredth of the rate gives hardly more than silence does");
    }

    #[tokio::test(start_paused = true)]
    async fn a_burst_earns_no_more_than_the_patience() {
        let mut rate = LeastRate::new(PATIENCE, 1000, 0);
        let now = after(4).await;
        assert_eq!(rate.wait(u64::MAX), now + PATIENCE);
    }

    #[tokio::test(start_paused = true)]
    async fn time_that_nobody_waits_is_no_fault_of_the_peer() {
        let mut rate = LeastRate::new(PATIENCE, 1000, 0);
        rate.wait(0);
        after(6).await;
        rate.rest();
        let now = after(100).await;
        assert_eq!(rate.wait(0), now + Duration::from_secs(2));
    }
}
