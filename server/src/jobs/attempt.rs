//! One attempt of a job: its worker process from start to end, and what the end means.

use std::time::Duration;

use tokio::process::Child;
use tracing::Instrument as _;

use super::{Room, lease::Lease, process, token::Mint};
use crate::{
    domain::{attempt::AttemptEnd, job::Job},
    telemetry::memory,
};

/// How long a worker that was asked to stop may take.
const GRACE: Duration = Duration::from_secs(10);

/// Runs the attempt that has claimed `job`.
pub(super) async fn run(room: &Room, job: Job, mint: Mint) {
    let span = tracing::info_span!("attempt", job.id = %job.id, job.kind = job.spec.kind().as_str(), job.attempt = job.attempt);
    async {
        let attempt = mint.attempt(&job.id);
        let lease = room.leases.grant(&attempt);
        tracing::info!("attempt started");
        let end = match process::start(&room.config, room.server, &mint.token(&job.id)) {
            Ok(child) => {
                crate::fail_point::pass("worker.started");
                let memory = memory::of_worker(child.id().unwrap_or(0), job.spec.kind().as_str());
                tokio::select! {
                    end = watch_over(room, child, &lease) => end,
                    never = memory => match never {},
                }
            }
            Err(error) => AttemptEnd::Broken(format!("the worker could not be started: {error}")),
        };
        // A stop is why, whatever the process looked like when it ended; and without room on the disk none can go on.
        let stopped = lease.stop.is_cancelled() || room.blobs.is_full();
        let end = if stopped { AttemptEnd::Stopped } else { end };
        room.end_surely(&attempt, &end).await;
        room.leases.end(&attempt);
    }
    .instrument(span)
    .await;
}

/// Waits for the process to end, and ends it when it is silent or does not stop when asked.
async fn watch_over(room: &Room, mut child: Child, lease: &Lease) -> AttemptEnd {
    let silence = Duration::from_secs(room.config.jobs.worker_silence_seconds);
    let why = tokio::select! {
        status = child.wait() => return match status {
            Ok(status) => AttemptEnd::Broken(process::describe(status)),
            Err(error) => AttemptEnd::Broken(format!("the worker was lost: {error}")),
        },
        () = lease.silent_for(silence) => format!("the worker said nothing for {} s and was killed", silence.as_secs()),
        () = stubborn(lease) => format!("the worker did not stop within {} s and was killed", GRACE.as_secs()),
    };
    tracing::warn!(reason = why, "killing the worker");
    if let Err(error) = child.kill().await {
        tracing::error!(%error, "the worker could not be killed");
    }
    AttemptEnd::Broken(why)
}

async fn stubborn(lease: &Lease) {
    lease.stop.cancelled().await;
    tokio::time::sleep(GRACE).await;
}
