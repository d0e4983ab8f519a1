//! How fast the sessions of one policy run, and how long its model may therefore wait for them to share a batch.

use std::{
    collections::HashMap,
    sync::{Arc, Mutex},
    time::{Duration, Instant},
};

use super::engine::lock;

/// A session that has asked for nothing in this many of its periods is not waited for.
const ABSENT: u32 = 2;

/// The open sessions of one policy.
pub(super) struct Pace {
    /// The part of the fastest session's period that its model may wait.
    share: f64,
    seats: Mutex<Seats>,
}

#[derive(Default)]
struct Seats {
    next: u64,
    taken: HashMap<u64, Rhythm>,
}

struct Rhythm {
    period: Duration,
    /// When it last asked; one that never did is not waited for yet.
    asked: Option<Instant>,
}

/// One open session's place; given up when dropped.
pub(super) struct Seat {
    pace: Arc<Pace>,
    key: u64,
}

impl Pace {
    pub(super) fn new(share: f64) -> Arc<Self> {
        Arc::new(Self { share, seats: Mutex::default() })
    }

    /// A session opens that will ask once a period.
    pub(super) fn join(self: &Arc<Self>, period: Duration) -> Seat {
        let mut seats = lock(&self.seats);
        let key = seats.next;
        seats.next += 1;
        seats.taken.insert(key, Rhythm { period, asked: None });
        Seat { pace: Arc::clone(self), key }
    }

    /// How many sessions ask at present, and how long a free model may wait for them; `None` when there is nobody to
    /// wait for.
    pub(super) fn patience(&self) -> Option<(usize, Duration)> {
        let now = Instant::now();
        let seats = lock(&self.seats);
        let present = || {
            let here = |seat: &&Rhythm| {
                seat.asked
                    .is_some_and(|asked| now.saturating_duration_since(asked) < seat.period.saturating_mul(ABSENT))
            };
            seats.taken.values().filter(here)
        };
        let count = present().count();
        let fastest = present().map(|seat| seat.period).min()?;
        (count > 1).then(|| (count, fastest.mul_f64(self.share)))
    }
}

impl Seat {
    /// Its session asks now.
    pub(super) fn asks(&self) {
        if let Some(rhythm) = lock(&self.pace.seats).taken.get_mut(&self.key) {
            rhythm.asked = Some(Instant::now());
        }
    }
}

impl Drop for Seat {
    fn drop(&mut self) {
        lock(&self.pace.seats).taken.remove(&self.key);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LONG: Duration = Duration::from_secs(100);

    fn present(pace: &Arc<Pace>, period: Duration) -> Seat {
        let seat = pace.join(period);
        seat.asks();
        seat
    }

    #[test]
    fn the_fastest_session_says_how_long() {
        let pace = Pace::new(0.05);
        assert!(pace.patience().is_none());
        let slow = present(&pace, LONG);
        assert!(pace.patience().is_none(), "alone, nobody is waited for");
        let fast = present(&pace, LONG / 10);
        assert_eq!(pace.patience().unwrap(), (2, LONG / 200));
        drop(slow);
        assert!(pace.patience().is_none());
        drop(fast);
    }

    #[test]
    fn a_session_that_asks_for_nothing_is_not_waited_for() {
        let pace = Pace::new(0.05);
        let _present = present(&pace, LONG);
        let _gone_quiet = present(&pace, Duration::ZERO);
        let _just_opened = pace.join(LONG);
        assert!(pace.patience().is_none());
    }

    #[test]
    fn no_share_is_no_wait() {
        let pace = Pace::new(0.0);
        let _both = (present(&pace, LONG), present(&pace, LONG));
        assert_eq!(pace.patience().unwrap(), (2, Duration::ZERO));
    }
}
