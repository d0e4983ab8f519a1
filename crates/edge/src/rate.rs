//! A minimum rate, as a deadline that received bytes push away. Must not depend on the content of the bytes.

use std::time::Duration;

use tokio::time::Instant;

/// Bytes must arrive at a minimum rate; for `patience` they may arrive more slowly. Time without a reader does not
/// count.
#[derive(Debug)]
pub(crate) struct MinimumRate {
    patience: Duration,
    /// The time by which one byte extends the deadline.
    byte: f64,
    deadline: Instant,
    /// The time since which there is no reader.
    rests_since: Option<Instant>,
    /// Bytes received at the last call of [`Self::wait`].
    seen: u64,
}

impl MinimumRate {
    /// A rate whose clock is stopped, because there is no reader yet.
    pub(crate) fn new(patience: Duration, bytes_per_second: u32, seen: u64) -> Self {
        let now = Instant::now();
        let byte = 1.0 / f64::from(bytes_per_second.max(1));
        Self { patience, byte, deadline: now + patience, rests_since: Some(now), seen }
    }

    /// A reader waits for bytes; `received` is their total. Returns the deadline for the next ones.
    pub(crate) fn wait(&mut self, received: u64) -> Instant {
        let now = Instant::now();
        let rested = self.rests_since.take().map_or(Duration::ZERO, |since| now - since);
        let new = received.saturating_sub(self.seen);
        self.seen = received;
        // Bytes beyond the equivalent of a day count as a day.
        #[expect(clippy::cast_precision_loss, reason = "far below 2^52 bytes")]
        let worth = Duration::try_from_secs_f64((new as f64 * self.byte).min(86_400.0)).unwrap_or_default();
        self.deadline = (self.deadline + rested + worth).min(now + self.patience);
        self.deadline
    }

    /// The reader stopped waiting.
    pub(crate) fn rest(&mut self) {
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
    async fn silence_is_accepted_within_the_allowed_time() {
        let begun = Instant::now();
        let mut rate = MinimumRate::new(PATIENCE, 1000, 0);
        assert_eq!(rate.wait(0), begun + PATIENCE);
        after(5).await;
        assert_eq!(rate.wait(0), begun + PATIENCE, "a repeated request gives no more time");
    }

    #[tokio::test(start_paused = true)]
    async fn peer_at_the_rate_continues_and_one_below_it_does_not() {
        let (mut good, mut drips) = (MinimumRate::new(PATIENCE, 1000, 0), MinimumRate::new(PATIENCE, 1000, 0));
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
    async fn a_burst_extends_the_time_by_at_most_the_allowed_time() {
        let mut rate = MinimumRate::new(PATIENCE, 1000, 0);
        let now = after(4).await;
        assert_eq!(rate.wait(u64::MAX), now + PATIENCE);
    }

    #[tokio::test(start_paused = true)]
    async fn time_without_a_reader_does_not_count() {
        let mut rate = MinimumRate::new(PATIENCE, 1000, 0);
        rate.wait(0);
        after(6).await;
        rate.rest();
        let now = after(100).await;
        assert_eq!(rate.wait(0), now + Duration::from_secs(2));
    }
}
