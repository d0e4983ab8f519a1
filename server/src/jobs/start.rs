//! The start of an attempt's worker: repeated for about a minute while this machine cannot start one.

use std::{sync::Arc, time::Duration};

use super::{
    Inner,
    engine::{Execution, Launch},
    lease::Lease,
    log::Log,
    token::Issuer,
};
use crate::domain::{attempt::Attempt, job::Job};

/// Pauses between the starts of a worker, which take about a minute together.
#[cfg(not(test))]
const FIRST_PAUSE: Duration = Duration::from_secs(1);
#[cfg(test)]
const FIRST_PAUSE: Duration = Duration::from_millis(1);
const LONGEST_PAUSE: Duration = FIRST_PAUSE.saturating_mul(32);

/// Starts the worker, again after a while if that fails: a machine may be out of processes or memory, and programs are
/// missing while they are replaced.
pub(super) async fn start(
    inner: &Inner,
    (job, attempt): (&Job, &Attempt),
    issuer: &Issuer,
    lease: &Arc<Lease>,
    log: &mut Log,
) -> Result<Box<dyn Execution>, String> {
    let mut pause = FIRST_PAUSE;
    loop {
        let reason = match inner.engine.start(Launch { job, attempt, token: issuer.token(&job.id), lease }) {
            Ok(execution) => {
                if lease.begun() {
                    // The pauses were not the worker's.
                    inner.leases.renew(attempt);
                }
                return Ok(execution);
            }
            Err(reason) => reason,
        };
        let reason = format!(
            "the worker could not be started: {reason}; check that gleaner-worker is beside gleaner-server, and that this \
             machine has free processes and memory"
        );
        tracing::error!(reason, "retrying to start a worker");
        log.note(&reason).await;
        let _ = lease.stop.run_until_cancelled(tokio::time::sleep(pause)).await;
        pause *= 2;
        if pause > LONGEST_PAUSE || lease.stop.is_cancelled() {
            return Err(reason);
        }
    }
}
