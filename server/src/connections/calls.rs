//! Who calls how often: so many calls a second, so many at once, so many in hand, for each client.

use std::{
    collections::HashMap,
    num::NonZeroU32,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicU32, Ordering::Relaxed},
    },
};

use governor::{DefaultKeyedRateLimiter, Quota, RateLimiter, clock::Clock as _};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use crate::{
    config::ConnectionsConfig,
    domain::client::Client,
    error::{Error, Result},
};

/// Calls that take as long as their caller, a recording or a model does. The others are questions.
const NO_QUESTIONS: [&str; 9] = [
    "/gleaner.v1.EpisodeService/WriteUpload",
    "/gleaner.v1.EpisodeService/FinishUpload",
    "/gleaner.v1.PolicyService/Act",
    "/gleaner.v1.PolicyService/Deploy",
    "/gleaner.v1.PolicyService/RollBack",
    "/gleaner.v1.PolicyService/Session",
    "/gleaner.v1.ScoreService/ScoreRecording",
    "/gleaner.v1.ScoreService/ScoreSteps",
    "/inference.GRPCInferenceService/ModelInfer",
];
/// Calls between two times at which clients that have not called for a while are forgotten.
const TIDY_EVERY: u32 = 4096;

/// The clients' calls.
pub(super) struct Calls {
    rate: DefaultKeyedRateLimiter<Client>,
    per_second: u32,
    tidied: AtomicU32,
    running: Arc<Running>,
}

/// So many a second, and twice as many at once.
fn rate(per_second: u32) -> Quota {
    let one = NonZeroU32::MIN;
    let burst = NonZeroU32::new(per_second.saturating_mul(2)).unwrap_or(one);
    Quota::per_second(NonZeroU32::new(per_second).unwrap_or(one)).allow_burst(burst)
}

/// Whether a call is answered at once, and so may wait for its turn.
pub(super) fn is_question(path: &str) -> bool {
    !NO_QUESTIONS.contains(&path)
}

struct Running {
    most: usize,
    in_hand: usize,
    questions: DefaultKeyedRateLimiter<Client>,
    by_client: Mutex<HashMap<Client, OfClient>>,
}

/// One client's calls.
struct OfClient {
    running: usize,
    turns: Arc<Semaphore>,
}

/// A call that runs until this and its clones are dropped. It is on its way among the call's extensions.
#[derive(Clone)]
pub(crate) struct Call(Arc<Place>);

struct Place {
    running: Arc<Running>,
    client: Client,
    turns: Arc<Semaphore>,
}

impl Call {
    /// Waits until few of its client's questions are in hand and the next one is due: who asks a hundred things at once
    /// waits for himself, and nobody waits for him. The turn is over when what is given here is dropped.
    pub(crate) async fn turn(&self) -> Option<OwnedSemaphorePermit> {
        let Place { running, client, turns } = &*self.0;
        // Nobody closes it.
        let turn = Arc::clone(turns).acquire_owned().await.ok();
        while let Err(early) = running.questions.check_key(client) {
            tokio::time::sleep(early.wait_time_from(running.questions.clock().now())).await;
        }
        turn
    }
}

impl Calls {
    pub(super) fn new(config: &ConnectionsConfig) -> Self {
        let (most, in_hand) = (config.calls_at_once, config.questions_in_hand);
        let questions = RateLimiter::keyed(rate(config.questions_per_second));
        Self {
            rate: RateLimiter::keyed(rate(config.calls_per_second)),
            per_second: config.calls_per_second,
            tidied: AtomicU32::new(0),
            running: Arc::new(Running { most, in_hand, questions, by_client: Mutex::default() }),
        }
    }

    /// Lets a call in.
    ///
    /// # Errors
    /// Exhausted, saying when to try again.
    pub(super) fn begin(&self, client: Client) -> Result<Call> {
        if self.tidied.fetch_add(1, Relaxed) % TIDY_EVERY == TIDY_EVERY - 1 {
            self.rate.retain_recent();
            self.running.questions.retain_recent();
        }
        if let Err(early) = self.rate.check_key(&client) {
            let wait = early.wait_time_from(self.rate.clock().now()).as_millis().max(1);
            metrics::counter!("gleaner_calls_refused_total", "reason" => "rate").increment(1);
            return Err(Error::exhausted(format!(
                "more than {} calls a second (--calls-per-second); try again in {wait} ms",
                self.per_second
            )));
        }
        let mut by_client = self.running.by_client();
        let fresh = || OfClient { running: 0, turns: Arc::new(Semaphore::new(self.running.in_hand)) };
        let own = by_client.entry(client.clone()).or_insert_with(fresh);
        if own.running >= self.running.most {
            metrics::counter!("gleaner_calls_refused_total", "reason" => "at_once").increment(1);
            let most = self.running.most;
            return Err(Error::exhausted(format!(
                "{most} calls run already (--calls-at-once); end one, then try again"
            )));
        }
        own.running += 1;
        let turns = Arc::clone(&own.turns);
        drop(by_client);
        Ok(Call(Arc::new(Place { running: Arc::clone(&self.running), client, turns })))
    }
}

impl Running {
    fn by_client(&self) -> MutexGuard<'_, HashMap<Client, OfClient>> {
        self.by_client.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Place {
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
    use std::time::Duration;

    use super::*;
    use crate::error::Kind;

    fn token(name: &str) -> Client {
        Client::Token(name.into())
    }

    fn calls(calls_per_second: u32, calls_at_once: usize, questions_in_hand: usize) -> Calls {
        let rest = ConnectionsConfig::default();
        Calls::new(&ConnectionsConfig { calls_per_second, calls_at_once, questions_in_hand, ..rest })
    }

    #[test]
    fn who_calls_too_often_is_told_when_to_call_again_and_others_go_on() {
        let calls = calls(1, 100, 3);
        calls.begin(token("a")).unwrap();
        calls.begin(token("a")).unwrap();
        let error = calls.begin(token("a")).err().unwrap();
        assert_eq!(error.kind(), Kind::Exhausted);
        assert!(error.message().contains("try again in ") && error.message().contains("--calls-per-second"), "{error}");
        calls.begin(token("b")).unwrap();
        calls.begin(Client::Address([127, 0, 0, 1].into())).unwrap();
    }

    #[test]
    fn so_many_run_at_once_and_no_more() {
        let calls = calls(1000, 2, 2);
        let first = calls.begin(token("a")).unwrap();
        let _second = calls.begin(token("a")).unwrap();
        let error = calls.begin(token("a")).err().unwrap();
        assert!(error.message().contains("--calls-at-once"), "{error}");
        let other = calls.begin(token("b")).unwrap();
        drop(first);
        let _third = calls.begin(token("a")).unwrap();
        drop(other);
        assert_eq!(calls.running.by_client().len(), 1, "who runs nothing is forgotten");
    }

    #[tokio::test]
    async fn a_client_waits_for_itself_and_for_nobody_else() {
        let calls = calls(1000, 100, 2);
        let [first, second, third] = [(); 3].map(|()| calls.begin(token("a")).unwrap());
        let (turn, _other) = (first.turn().await.unwrap(), second.turn().await.unwrap());
        let mut waits = Box::pin(third.turn());
        assert!(futures::poll!(&mut waits).is_pending());
        let other = calls.begin(token("b")).unwrap();
        assert!(futures::poll!(Box::pin(other.turn())).is_ready());
        drop(turn);
        assert!(waits.await.is_some());
    }

    #[tokio::test]
    async fn questions_too_many_wait_and_are_not_refused() {
        let rest = ConnectionsConfig::default();
        let calls = Calls::new(&ConnectionsConfig { questions_per_second: 50, ..rest });
        let begun = std::time::Instant::now();
        for _ in 0..110 {
            drop(calls.begin(token("a")).unwrap().turn().await);
        }
        assert!(begun.elapsed() >= Duration::from_millis(190), "ten above a hundred at once are a fifth of a second");
    }
}
