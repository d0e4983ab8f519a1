//! Leases: the attempts whose worker processes this server runs, each with the time of its last call and its request to
//! stop.

use std::{
    collections::HashMap,
    convert::Infallible,
    future::pending,
    net::SocketAddr,
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};

use tokio::{
    sync::watch,
    time::{Instant, sleep_until},
};
use tokio_util::sync::CancellationToken;

use crate::domain::{attempt::Attempt, id::JobId};

/// Interval of signs of life during a call that takes long. The shortest limit of silence is a second.
const RENEW_EVERY: Duration = Duration::from_millis(500);

/// One running attempt.
pub(super) struct Lease {
    /// The time of the last call; `None` before the first one of a worker that may start late.
    renewed_at: watch::Sender<Option<Instant>>,
    /// Cancelled when the job is cancelled, and with a worker of the server's own when the server stops.
    pub(super) stop: CancellationToken,
    /// Cancelled once the worker has delivered a result or the reason of a failure.
    pub(super) delivered: CancellationToken,
    /// Whether a second process has called for this attempt.
    contested: AtomicBool,
    /// The process of each rank above 0 that has called.
    members: Mutex<HashMap<u32, String>>,
    /// Where rank 0 waits for the others.
    meeting: watch::Sender<Option<SocketAddr>>,
}

impl Lease {
    /// Waits until the worker has made no call for `limit`. The time before a late worker's first call does not count.
    pub(super) async fn silent_for(&self, limit: Duration) {
        let mut renewed = self.renewed_at.subscribe();
        loop {
            // The sender is a field of this lease, so the wait ends with a call only.
            let Ok(Some(at)) = renewed.wait_for(Option::is_some).await.map(|at| *at) else { return pending().await };
            // With a limit beyond all times, such as the largest number, no attempt ends.
            let Some(until) = at.checked_add(limit) else { return pending().await };
            if until <= Instant::now() {
                return;
            }
            sleep_until(until).await;
        }
    }

    /// Whether the worker has called, or is known to run.
    pub(super) fn begun(&self) -> bool {
        self.renewed_at.borrow().is_some()
    }

    /// Whether a second process has called for this attempt: the engine's view of it is then of the wrong one.
    pub(super) fn contested(&self) -> bool {
        self.contested.load(Ordering::Relaxed)
    }

    fn touch(&self) {
        self.renewed_at.send_replace(Some(Instant::now()));
    }
}

/// How the worker of a lease is tied to this server.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Tie {
    /// The worker ends with the server, and starts at once.
    Child,
    /// The worker outlives the server, and starts at some time.
    Remote,
    /// As `Remote`, and the worker is known to run.
    Resumed,
}

/// Every running attempt of this server.
pub(super) struct Leases {
    held: Mutex<HashMap<Attempt, Arc<Lease>>>,
    stopping: CancellationToken,
}

impl Leases {
    /// No lease yet; those of child processes are asked to stop with `stopping`.
    pub(super) fn new(stopping: CancellationToken) -> Self {
        Self { held: Mutex::default(), stopping }
    }

    /// Begins the lease of an attempt.
    pub(super) fn grant(&self, attempt: &Attempt, tie: Tie) -> Arc<Lease> {
        let (renewed_at, stop) = match tie {
            Tie::Child => (Some(Instant::now()), self.stopping.child_token()),
            Tie::Remote => (None, CancellationToken::new()),
            Tie::Resumed => (Some(Instant::now()), CancellationToken::new()),
        };
        let lease = Arc::new(Lease {
            renewed_at: watch::Sender::new(renewed_at),
            stop,
            delivered: CancellationToken::new(),
            contested: AtomicBool::new(false),
            members: Mutex::default(),
            meeting: watch::Sender::default(),
        });
        self.all(|held| held.insert(attempt.clone(), Arc::clone(&lease)));
        lease
    }

    /// Ends the lease of an attempt.
    pub(super) fn end(&self, attempt: &Attempt) {
        self.all(|held| held.remove(attempt));
    }

    /// Records a call of the attempt's worker.
    pub(super) fn renew(&self, attempt: &Attempt) {
        if let Some(lease) = self.of(attempt) {
            lease.touch();
        }
    }

    /// Does the work of a call of the attempt's worker and renews the lease meanwhile, because the worker waits for the answer
    /// and makes no other call.
    pub(super) async fn renew_during<T>(&self, attempt: &Attempt, work: impl Future<Output = T>) -> T {
        tokio::select! {
            biased;
            never = self.keep_renewing(attempt) => match never {},
            done = work => done,
        }
    }

    async fn keep_renewing(&self, attempt: &Attempt) -> Infallible {
        let mut ticks = tokio::time::interval(RENEW_EVERY);
        loop {
            self.renew(attempt);
            ticks.tick().await;
        }
    }

    /// Records a call of a second process for the attempt.
    pub(super) fn contest(&self, attempt: &Attempt) {
        if let Some(lease) = self.of(attempt) {
            lease.contested.store(true, Ordering::Relaxed);
        }
    }

    /// Whether this process is the first that called as this rank, above 0, of the attempt.
    pub(super) fn admit(&self, attempt: &Attempt, rank: u32, process: &str) -> bool {
        self.of(attempt).is_some_and(|lease| {
            let mut members = lease.members.lock().unwrap_or_else(PoisonError::into_inner);
            members.entry(rank).or_insert_with(|| process.to_owned()) == process
        })
    }

    /// Records where rank 0 of the attempt waits for the others.
    pub(super) fn meet(&self, attempt: &Attempt, address: SocketAddr) {
        if let Some(lease) = self.of(attempt) {
            lease.meeting.send_replace(Some(address));
        }
    }

    /// Waits until rank 0 of the attempt has reported where it waits for the others.
    pub(super) async fn meeting(&self, attempt: &Attempt) -> SocketAddr {
        let Some(lease) = self.of(attempt) else { return pending().await };
        let mut meeting = lease.meeting.subscribe();
        // The sender is a field of the lease, which this function holds.
        match meeting.wait_for(Option::is_some).await.map(|address| *address) {
            Ok(Some(address)) => address,
            Ok(None) | Err(_) => pending().await,
        }
    }

    /// Records that the attempt's worker has delivered its result or the reason of its failure.
    pub(super) fn deliver(&self, attempt: &Attempt) {
        if let Some(lease) = self.of(attempt) {
            lease.delivered.cancel();
        }
    }

    fn of(&self, attempt: &Attempt) -> Option<Arc<Lease>> {
        self.all(|held| held.get(attempt).cloned())
    }

    /// Requests the workers of a job to stop.
    pub(super) fn stop(&self, job: &JobId) {
        self.all(|held| {
            held.iter().filter(|(attempt, _)| attempt.job_id == *job).for_each(|(_, lease)| lease.stop.cancel())
        });
    }

    /// Whether this attempt was asked to stop.
    pub(super) fn stopped(&self, attempt: &Attempt) -> bool {
        self.all(|held| held.get(attempt).is_some_and(|lease| lease.stop.is_cancelled()))
    }

    fn all<T>(&self, act: impl FnOnce(&mut HashMap<Attempt, Arc<Lease>>) -> T) -> T {
        act(&mut self.held.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

#[cfg(test)]
mod tests;
