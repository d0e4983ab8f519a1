//! The supervisor: starts up to the configured number of worker processes, each for the first job in order that is
//! ready.

use std::{sync::Arc, time::Duration};

use super::{Inner, attempt, token::Issuer};
use crate::domain::job::Job;

/// Longest time without a notification until the queue is read again.
const FALLBACK: Duration = Duration::from_secs(30);

/// Runs attempts until the server stops.
pub(super) async fn supervise(inner: Arc<Inner>) {
    let running = async {
        // The semaphore is never closed, so this ends only with the server.
        while let Ok(slot) = Arc::clone(&inner.slots).acquire_owned().await {
            let (job, issuer) = next_job(&inner).await;
            let task = Arc::clone(&inner);
            inner.tasks.spawn(async move {
                attempt::run(&task, job, issuer).await;
                drop(slot);
            });
        }
    };
    // Dropping `running` during a claim is safe: a claim that was committed without a worker is requeued at the next
    // start.
    let _ = inner.stopping.run_until_cancelled(running).await;
}

/// Waits for a job that is ready, and claims it.
async fn next_job(inner: &Inner) -> (Job, Issuer) {
    // Claims that failed: one whose connection was lost during its commit may hold a job without a worker.
    let mut unsure: Vec<String> = Vec::new();
    loop {
        while let Some(hash) = unsure.last() {
            match inner.store.give_back(hash).await {
                Ok(()) => {
                    unsure.pop();
                }
                Err(_) => break,
            }
        }
        // A notification between the check and the wait is kept as a permit.
        let issuer = Issuer::new();
        // Jobs write results, so they start only while the disk has room.
        let claimed = if inner.blobs.is_full() {
            Ok(None)
        } else {
            inner.store.claim_job(&issuer.hash, inner.engine.name()).await
        };
        match claimed {
            Ok(Some(job)) => {
                inner.changed.send_replace(());
                return (job, issuer);
            }
            Ok(None) => {}
            Err(error) => {
                tracing::error!(%error, "the queue cannot be read; retrying");
                unsure.push(issuer.hash);
            }
        }
        // The cause of the wake-up does not matter.
        let _ = tokio::time::timeout(FALLBACK, inner.ready.notified()).await;
    }
}
