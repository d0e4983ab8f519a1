//! Leases: the attempts whose worker processes this server runs, each with the time of its last call and its request to
//! stop.

use std::{
    collections::HashMap,
    sync::{Arc, Mutex, PoisonError},
    time::Duration,
};

use tokio::time::{Instant, sleep_until};
use tokio_util::sync::CancellationToken;

use crate::domain::{attempt::Attempt, id::JobId};

/// One running attempt.
pub(super) struct Lease {
    renewed_at: Mutex<Instant>,
    /// Cancelled when the job is cancelled or the server stops.
    pub(super) stop: CancellationToken,
}

impl Lease {
    /// Waits until the worker has made no call for `limit`.
    pub(super) async fn silent_for(&self, limit: Duration) {
        loop {
            let over = *self.renewed_at.lock().unwrap_or_else(PoisonError::into_inner) + limit;
            if over <= Instant::now() {
                return;
            }
            sleep_until(over).await;
        }
    }

    fn touch(&self) {
        *self.renewed_at.lock().unwrap_or_else(PoisonError::into_inner) = Instant::now();
    }
}

/// Every running attempt of this server.
pub(super) struct Leases {
    held: Mutex<HashMap<Attempt, Arc<Lease>>>,
    stopping: CancellationToken,
}

impl Leases {
    /// No lease yet; all are asked to stop with `stopping`.
    pub(super) fn new(stopping: CancellationToken) -> Self {
        Self { held: Mutex::default(), stopping }
    }

    /// Begins the lease of an attempt.
    pub(super) fn grant(&self, attempt: &Attempt) -> Arc<Lease> {
        let lease = Arc::new(Lease { renewed_at: Mutex::new(Instant::now()), stop: self.stopping.child_token() });
        self.all(|held| held.insert(attempt.clone(), Arc::clone(&lease)));
        lease
    }

    /// Ends the lease of an attempt.
    pub(super) fn end(&self, attempt: &Attempt) {
        self.all(|held| held.remove(attempt));
    }

    /// Records a call of the attempt's worker.
    pub(super) fn renew(&self, attempt: &Attempt) {
        if let Some(lease) = self.all(|held| held.get(attempt).cloned()) {
            lease.touch();
        }
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
mod tests {
    use super::*;

    fn attempt() -> Attempt {
        Attempt { job_id: JobId::new(), token_hash: "hash".to_owned() }
    }

    #[tokio::test(start_paused = true)]
    async fn a_report_resets_the_silence() {
        let leases = Leases::new(CancellationToken::new());
        let (attempt, begun) = (attempt(), Instant::now());
        let lease = leases.grant(&attempt);
        let limit = Duration::from_secs(120);
        let words = async {
            tokio::time::sleep(Duration::from_secs(100)).await;
            leases.renew(&attempt);
            std::future::pending::<()>().await;
        };
        tokio::select! {
            () = lease.silent_for(limit) => {}
            () = words => {}
        }
        assert_eq!(begun.elapsed().as_secs(), 220);
    }

    #[test]
    fn one_job_is_stopped_and_then_all() {
        let stopping = CancellationToken::new();
        let leases = Leases::new(stopping.clone());
        let (one, other) = (attempt(), attempt());
        let (_a, _b) = (leases.grant(&one), leases.grant(&other));
        leases.stop(&one.job_id);
        assert!(leases.stopped(&one) && !leases.stopped(&other));
        stopping.cancel();
        assert!(leases.stopped(&other));
        leases.end(&other);
        assert!(!leases.stopped(&other));
    }
}
