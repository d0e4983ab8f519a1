//! The calls of each client: their rate, their number at the same time, and the queue of unary calls. Must not depend
//! on the identification of clients.

use std::{
    collections::HashMap,
    hash::Hash,
    num::NonZeroU32,
    pin::Pin,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicU32, Ordering::Relaxed},
    },
    time::Duration,
};

use governor::{DefaultKeyedRateLimiter, Quota, RateLimiter, clock::Clock as _};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use crate::{config::EdgeConfig, error::EdgeError};

/// Number of calls between two removals of the rates of idle clients.
const TIDY_EVERY: u32 = 4096;

/// Identifies the client of a call.
pub trait ClientKey: Clone + Eq + Hash + Send + Sync + 'static {}

impl<K: Clone + Eq + Hash + Send + Sync + 'static> ClientKey for K {}

/// The calls of all clients.
pub(crate) struct Calls<K: ClientKey> {
    rate: DefaultKeyedRateLimiter<K>,
    per_second: u32,
    tidied: AtomicU32,
    running: Arc<Running<K>>,
}

/// A quota of this many calls per second, and twice as many in a burst.
fn rate(per_second: u32) -> Quota {
    let one = NonZeroU32::MIN;
    let burst = NonZeroU32::new(per_second.saturating_mul(2)).unwrap_or(one);
    Quota::per_second(NonZeroU32::new(per_second).unwrap_or(one)).allow_burst(burst)
}

struct Running<K: ClientKey> {
    limit: usize,
    unary_limit: usize,
    unary_calls: DefaultKeyedRateLimiter<K>,
    by_client: Mutex<HashMap<K, ClientCalls>>,
}

/// The calls of one client.
struct ClientCalls {
    running: usize,
    turns: Arc<Semaphore>,
}

/// A call that runs until this and its clones are dropped. The layer finds it among a request's extensions.
#[derive(Clone)]
pub struct Call(Arc<dyn Queue>);

/// A call's place in the queue of its client, whatever identifies the client.
trait Queue: Send + Sync {
    fn turn(&self) -> Pin<Box<dyn Future<Output = Option<OwnedSemaphorePermit>> + Send + '_>>;
}

struct Counted<K: ClientKey> {
    running: Arc<Running<K>>,
    client: K,
    turns: Arc<Semaphore>,
}

impl Call {
    /// Waits until its client has fewer unary calls running than the limit and the rate allows the next one. A client
    /// with many calls under way is queued behind its own calls. The turn ends when the result is dropped.
    pub async fn turn(&self) -> Option<OwnedSemaphorePermit> {
        self.0.turn().await
    }
}

impl<K: ClientKey> Queue for Counted<K> {
    fn turn(&self) -> Pin<Box<dyn Future<Output = Option<OwnedSemaphorePermit>> + Send + '_>> {
        Box::pin(async {
            // The semaphore is never closed.
            let turn = Arc::clone(&self.turns).acquire_owned().await.ok();
            let unary_calls = &self.running.unary_calls;
            while let Err(early) = unary_calls.check_key(&self.client) {
                tokio::time::sleep(early.wait_time_from(unary_calls.clock().now())).await;
            }
            turn
        })
    }
}

impl<K: ClientKey> Calls<K> {
    pub(crate) fn new(config: &EdgeConfig) -> Self {
        let running = Running {
            limit: config.calls_at_once,
            unary_limit: config.unary_calls_at_once,
            unary_calls: RateLimiter::keyed(rate(config.unary_calls_per_second)),
            by_client: Mutex::default(),
        };
        Self {
            rate: RateLimiter::keyed(rate(config.calls_per_second)),
            per_second: config.calls_per_second,
            tidied: AtomicU32::new(0),
            running: Arc::new(running),
        }
    }

    /// Admits a call.
    ///
    /// # Errors
    /// [`EdgeError::CallRate`] or [`EdgeError::CallsAtOnce`].
    pub(crate) fn begin(&self, client: K) -> Result<Call, EdgeError> {
        if self.tidied.fetch_add(1, Relaxed) % TIDY_EVERY == TIDY_EVERY - 1 {
            self.rate.retain_recent();
            self.running.unary_calls.retain_recent();
        }
        if let Err(early) = self.rate.check_key(&client) {
            metrics::counter!("gleaner_calls_refused_total", "reason" => "rate").increment(1);
            let retry_after = early.wait_time_from(self.rate.clock().now()).max(Duration::from_millis(1));
            return Err(EdgeError::CallRate { limit: self.per_second, retry_after });
        }
        let mut by_client = self.running.by_client();
        let fresh = || ClientCalls { running: 0, turns: Arc::new(Semaphore::new(self.running.unary_limit)) };
        let own = by_client.entry(client.clone()).or_insert_with(fresh);
        if own.running >= self.running.limit {
            metrics::counter!("gleaner_calls_refused_total", "reason" => "at_once").increment(1);
            return Err(EdgeError::CallsAtOnce { limit: self.running.limit });
        }
        own.running += 1;
        let turns = Arc::clone(&own.turns);
        drop(by_client);
        Ok(Call(Arc::new(Counted { running: Arc::clone(&self.running), client, turns })))
    }
}

impl<K: ClientKey> Running<K> {
    fn by_client(&self) -> MutexGuard<'_, HashMap<K, ClientCalls>> {
        self.by_client.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<K: ClientKey> Drop for Counted<K> {
    fn drop(&mut self) {
        let mut by_client = self.running.by_client();
        if let Some(own) = by_client.get_mut(&self.client) {
            own.running -= 1;
            if own.running == 0 {
                by_client.remove(&self.client);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::config;

    fn calls(calls_per_second: u32, calls_at_once: usize, unary_calls_at_once: usize) -> Calls<&'static str> {
        Calls::new(&EdgeConfig { calls_per_second, calls_at_once, unary_calls_at_once, ..config() })
    }

    #[test]
    fn calls_above_the_rate_are_refused_with_a_time_to_retry_and_others_continue() {
        let calls = calls(1, 100, 3);
        calls.begin("a").unwrap();
        calls.begin("a").unwrap();
        let refusal = calls.begin("a").err().unwrap();
        let EdgeError::CallRate { limit: 1, retry_after } = refusal else { panic!("{refusal}") };
        assert!(retry_after >= Duration::from_millis(1));
        calls.begin("b").unwrap();
        calls.begin("c").unwrap();
    }

    #[test]
    fn calls_above_the_limit_at_once_are_refused() {
        let calls = calls(1000, 2, 2);
        let first = calls.begin("a").unwrap();
        let _second = calls.begin("a").unwrap();
        assert_eq!(calls.begin("a").err(), Some(EdgeError::CallsAtOnce { limit: 2 }));
        let other = calls.begin("b").unwrap();
        drop(first);
        let _third = calls.begin("a").unwrap();
        drop(other);
        assert_eq!(calls.running.by_client().len(), 1, "a client without calls is forgotten");
    }

    #[tokio::test]
    async fn a_client_is_queued_behind_its_own_calls_only() {
        let calls = calls(1000, 100, 2);
        let [first, second, third] = [(); 3].map(|()| calls.begin("a").unwrap());
        let (turn, _other) = (first.turn().await.unwrap(), second.turn().await.unwrap());
        let mut waits = Box::pin(third.turn());
        assert!(futures::poll!(&mut waits).is_pending());
        let other = calls.begin("b").unwrap();
        assert!(futures::poll!(Box::pin(other.turn())).is_ready());
        drop(turn);
        assert!(waits.await.is_some());
    }

    #[tokio::test]
    async fn unary_calls_above_the_rate_wait_and_are_not_refused() {
        let calls = Calls::new(&EdgeConfig { unary_calls_per_second: 50, ..config() });
        let begun = std::time::Instant::now();
        for _ in 0..110 {
            drop(calls.begin("a").unwrap().turn().await);
        }
        assert!(begun.elapsed() >= Duration::from_millis(190), "ten above a hundred at once are a fifth of a second");
    }
}
