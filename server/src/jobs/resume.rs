//! The attempts that an earlier server left running: those of an engine whose workers outlive the server are watched again,
//! the others end.

use std::sync::Arc;

use super::{
    Inner, attempt,
    lease::{Lease, Tie},
};
use crate::{
    domain::attempt::{Attempt, AttemptEnd},
    error::Result,
    store::attempt::RunningAttempt,
};

/// Resumes or ends every running attempt.
///
/// # Errors
/// When the database cannot be read.
pub(super) async fn resume(inner: &Arc<Inner>) -> Result<()> {
    let mut over = Vec::new();
    for left in inner.store.running_attempts().await? {
        let lease = grant(inner, &left);
        let Some(execution) = inner.engine.resume(&left.attempt, &left.placement, &lease) else {
            inner.leases.end(&left.attempt);
            over.push(left.attempt);
            continue;
        };
        let job = inner.store.job(&left.attempt.job_id).await?;
        if job.cancel_requested {
            lease.stop.cancel();
        }
        // Fewer slots than before do not end attempts that run.
        let slot = Arc::clone(&inner.slots).try_acquire_owned().ok();
        let task = Arc::clone(inner);
        inner.tasks.spawn(async move {
            attempt::resume(&task, job, left.attempt, &lease, execution).await;
            drop(slot);
        });
    }
    let ending = Arc::clone(inner);
    // In the background: a full or slow disk must not delay the start.
    inner.tasks.spawn(async move {
        for attempt in over {
            ending.end_with_retries(&attempt, &AttemptEnd::Stopped).await;
        }
    });
    Ok(())
}

fn grant(inner: &Inner, left: &RunningAttempt) -> Arc<Lease> {
    let RunningAttempt { attempt, bound, .. } = left;
    let attempt: &Attempt = attempt;
    inner.leases.grant(attempt, if *bound { Tie::Resumed } else { Tie::Remote })
}
