//! The request rates of a policy's sessions, and how long its model may wait to batch them.

use std::{
    collections::HashMap,
    sync::{Arc, Mutex},
    time::{Duration, Instant},
};

use super::lock::lock;

/// A session without a request in this many of its periods counts as absent.
const ABSENT: u32 = 2;

/// The open sessions of one policy.
pub(super) struct SessionRates {
    /// The part of the fastest session's period for which the model may wait.
    share: f64,
    /// The longest period of which a part is waited: callers without a session wait too, whatever rates sessions state.
    longest: Duration,
    rates: Mutex<Rates>,
}

#[derive(Default)]
struct Rates {
    next: u64,
    sessions: HashMap<u64, SessionRate>,
}

struct SessionRate {
    period: Duration,
    /// The time of its last request; a session without any counts as absent.
    last_request: Option<Instant>,
}

/// An open session's entry; removed on drop.
pub(super) struct RateGuard {
    rates: Arc<SessionRates>,
    key: u64,
}

impl SessionRates {
    pub(super) fn new(share: f64, longest: Duration) -> Arc<Self> {
        Arc::new(Self { share, longest, rates: Mutex::default() })
    }

    /// Adds a session that sends one request per period.
    pub(super) fn join(self: &Arc<Self>, period: Duration) -> RateGuard {
        let mut rates = lock(&self.rates);
        let key = rates.next;
        rates.next += 1;
        rates.sessions.insert(key, SessionRate { period, last_request: None });
        RateGuard { rates: Arc::clone(self), key }
    }

    /// The number of present sessions and how long a free model may wait for them; `None` when at most one is present.
    pub(super) fn patience(&self) -> Option<(usize, Duration)> {
        let now = Instant::now();
        let rates = lock(&self.rates);
        let present = || {
            let here = |guard: &&SessionRate| {
                guard
                    .last_request
                    .is_some_and(|last| now.saturating_duration_since(last) < guard.period.saturating_mul(ABSENT))
            };
            rates.sessions.values().filter(here)
        };
        let count = present().count();
        let fastest = present().map(|guard| guard.period).min()?;
        (count > 1).then(|| (count, fastest.min(self.longest).mul_f64(self.share)))
    }
}

impl RateGuard {
    /// Notes a request of this session.
    pub(super) fn record_request(&self) {
        if let Some(rate) = lock(&self.rates.rates).sessions.get_mut(&self.key) {
            rate.last_request = Some(Instant::now());
        }
    }
}

impl Drop for RateGuard {
    fn drop(&mut self) {
        lock(&self.rates.rates).sessions.remove(&self.key);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LONG: Duration = Duration::from_secs(100);

    fn present(rates: &Arc<SessionRates>, period: Duration) -> RateGuard {
        let guard = rates.join(period);
        guard.record_request();
        guard
    }

    #[test]
    fn the_wait_is_a_part_of_the_fastest_period() {
        let rates = SessionRates::new(0.05, LONG);
        assert!(rates.patience().is_none());
        let slow = present(&rates, LONG);
        assert!(rates.patience().is_none(), "a single session");
        let fast = present(&rates, LONG / 10);
        assert_eq!(rates.patience().unwrap(), (2, LONG / 200));
        drop(slow);
        assert!(rates.patience().is_none());
        drop(fast);
    }

    #[test]
    fn absent_sessions_are_not_waited_for() {
        let rates = SessionRates::new(0.05, LONG);
        let _present = present(&rates, LONG);
        let _gone_quiet = present(&rates, Duration::ZERO);
        let _just_opened = rates.join(LONG);
        assert!(rates.patience().is_none());
    }

    #[test]
    fn sessions_slower_than_the_task_do_not_lengthen_the_wait() {
        let rates = SessionRates::new(0.5, LONG);
        let _both = (present(&rates, Duration::MAX), present(&rates, 10 * LONG));
        assert_eq!(rates.patience().unwrap(), (2, LONG / 2));
    }

    #[test]
    fn a_share_of_zero_disables_the_wait() {
        let rates = SessionRates::new(0.0, LONG);
        let _both = (present(&rates, LONG), present(&rates, LONG));
        assert_eq!(rates.patience().unwrap(), (2, Duration::ZERO));
    }
}
