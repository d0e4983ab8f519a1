//! One attempt of a job: its worker process from start to end, and the meaning of that end.

use std::{io::Write as _, pin::pin, sync::Arc, time::Duration};

use bytes::Bytes;
use gleaner_recording::printable::Escape;
use tokio::{io::AsyncRead, sync::watch};
use tracing::Instrument as _;

use super::{
    Inner,
    engine::{End, Execution},
    lease::{Lease, Tie},
    log::Log,
    start::start,
    token::Issuer,
};
use crate::domain::{
    attempt::{Attempt, AttemptEnd},
    id::BlobId,
    job::Job,
    placement::Placement,
    time::Millis,
};

/// Longest time from a request to stop until the worker is killed.
const GRACE: Duration = Duration::from_secs(10);
/// Longest wait for the rest of an ended worker's output.
const LAST_OUTPUT: Duration = Duration::from_secs(2);

/// Runs the attempt that has claimed `job`.
pub(super) async fn run(inner: &Inner, job: Job, issuer: Issuer) {
    async {
        let attempt = issuer.attempt(&job.id);
        let lease = inner.leases.grant(&attempt, if inner.engine.outlives_server() { Tie::Remote } else { Tie::Child });
        tracing::info!("attempt started");
        // The first report of a worker of the server's own returns a cancellation between the claim and the lease.
        if inner.engine.outlives_server() && inner.store.job(&job.id).await.is_ok_and(|job| job.cancel_requested) {
            lease.stop.cancel();
        }
        let mut log = Log::of(&inner.config.data_dir, &job.id).await;
        log.note(&format!("attempt {} of {} begins", job.attempt, job.max_attempts)).await;
        let end = match start(inner, (&job, &attempt), &issuer, &lease, &mut log).await {
            Ok(execution) => until_over(inner, &attempt, execution, &lease, &mut log).await,
            // The machine's fault: every job of the queue would otherwise use up its attempts within a second.
            Err(reason) => Some(End::Interrupted(reason)),
        };
        conclude(inner, (&job, From::Start), &attempt, &lease, end, &mut log).await;
    }
    .instrument(span(&job))
    .await;
}

/// Runs the rest of an attempt that an earlier server started.
pub(super) async fn resume(
    inner: &Inner,
    job: Job,
    attempt: Attempt,
    lease: &Arc<Lease>,
    execution: Box<dyn Execution>,
) {
    async {
        tracing::info!("attempt resumed");
        let mut log = Log::of(&inner.config.data_dir, &job.id).await;
        let end = until_over(inner, &attempt, execution, lease, &mut log).await;
        conclude(inner, (&job, From::Middle), &attempt, lease, end, &mut log).await;
    }
    .instrument(span(&job))
    .await;
}

/// Follows a worker to its end. `None` when the server stops first and the worker continues without it.
async fn until_over(
    inner: &Inner,
    attempt: &Attempt,
    mut execution: Box<dyn Execution>,
    lease: &Arc<Lease>,
    log: &mut Log,
) -> Option<End> {
    let end = watch_over(inner, attempt, execution.as_mut(), lease, log);
    if inner.engine.outlives_server() { inner.stopping.run_until_cancelled(end).await } else { Some(end.await) }
}

fn span(job: &Job) -> tracing::Span {
    tracing::info_span!("attempt", job.id = %job.id, job.kind = job.spec.kind().as_str(), job.attempt = job.attempt)
}

/// Which part of an attempt this server has run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum From {
    /// All of it.
    Start,
    /// What an earlier server left of it.
    Middle,
}

/// Stores the end of an attempt, if it has ended.
async fn conclude(
    inner: &Inner,
    (job, from): (&Job, From),
    attempt: &Attempt,
    lease: &Lease,
    end: Option<End>,
    log: &mut Log,
) {
    let Some(end) = end else { return };
    // A requested stop is the reason however the process ended, and on a full disk no attempt can continue.
    let stopped = lease.stop.is_cancelled() || inner.blobs.is_full();
    let end = if stopped { AttemptEnd::Stopped } else { end.of_attempt(saved_checkpoint(inner, job, from).await) };
    inner.end_with_retries(attempt, &end).await;
    inner.leases.end(attempt);
    log.note(&standing(inner, job).await).await;
}

/// Whether the attempt has saved a checkpoint: the job's is newer than at the beginning of the attempt, or than this server
/// found it, or was stored since the attempt began.
async fn saved_checkpoint(inner: &Inner, job: &Job, from: From) -> bool {
    let Ok(now) = inner.store.job(&job.id).await else { return false };
    if now.checkpoint_step > job.checkpoint_step {
        return true;
    }
    match from {
        From::Start => false,
        From::Middle => stored_since(inner, now.checkpoint, now.started_at).await,
    }
}

/// Whether a blob was stored at this time or later; not if the time of either is unknown.
async fn stored_since(inner: &Inner, blob: Option<BlobId>, begun: Option<Millis>) -> bool {
    let (Some(blob), Some(begun), blobs) = (blob, begun, inner.blobs.clone()) else { return false };
    let placed = tokio::task::spawn_blocking(move || blobs.placed(&blob)).await;
    placed.is_ok_and(|placed| placed.is_ok_and(|placed| placed.is_some_and(|placed| Millis::of(placed) >= begun)))
}

/// The output of `end`, once all of the worker's output before it is logged.
async fn with_output(end: impl Future<Output = End>, log: &mut Log, output: Option<impl AsyncRead + Unpin>) -> End {
    let Some(output) = output else { return end.await };
    let (mut end, mut following) = (pin!(end), pin!(log.follow(output, pass_on)));
    tokio::select! {
        end = &mut end => {
            // The pipe closes with the worker; if another process still holds it open, the wait ends after
            // `LAST_OUTPUT`.
            let _ = tokio::time::timeout(LAST_OUTPUT, following).await;
            end
        }
        () = &mut following => end.await,
    }
}

/// Writes to standard error, where the server's own log is, with unprintable characters escaped; not on the runtime,
/// because the reader of standard error may be slow.
async fn pass_on(lines: Bytes) {
    let escaped = Escape::Lines.apply(&String::from_utf8_lossy(&lines)).into_owned();
    // A failed write to standard error does not stop the job.
    let _ = tokio::task::spawn_blocking(move || std::io::stderr().write_all(escaped.as_bytes())).await;
}

/// The state of the job after an attempt, in words.
async fn standing(inner: &Inner, job: &Job) -> String {
    let ended = format!("attempt {} has ended", job.attempt);
    match inner.store.job(&job.id).await {
        Ok(Job { attempt, .. }) if attempt > job.attempt => format!("{ended}; the next one resumes the job"),
        Ok(Job { state, error, message, .. }) => {
            let reason = if error.is_empty() { message } else { error };
            format!("{ended}; the job is {}: {reason}", state.as_str())
        }
        Err(error) => format!("{ended}; the state of the job cannot be read: {error}"),
    }
}

/// Follows a worker to its end: its output, its place, its silence and its answer to a request to stop.
async fn watch_over(
    inner: &Inner,
    attempt: &Attempt,
    execution: &mut dyn Execution,
    lease: &Arc<Lease>,
    log: &mut Log,
) -> End {
    let (output, placement) = (execution.output(), execution.placement());
    tokio::select! {
        end = with_output(until_end(inner, execution, lease), log, output) => end,
        never = record(inner, attempt, placement) => match never {},
    }
}

/// Stores each new place of the worker, for as long as it is polled.
async fn record(
    inner: &Inner,
    attempt: &Attempt,
    mut placement: watch::Receiver<Placement>,
) -> std::convert::Infallible {
    placement.mark_changed();
    loop {
        if placement.changed().await.is_err() {
            return std::future::pending().await;
        }
        let new = placement.borrow_and_update().clone();
        match inner.store.place_attempt(attempt, &new).await {
            Ok(()) => inner.changed.send_replace(()),
            // The place is for people only; the next change is stored again.
            Err(error) => tracing::warn!(%error, "the place of a worker cannot be stored"),
        }
    }
}

/// Waits for the worker to end, and kills it when it is silent or ignores a request to stop.
async fn until_end(inner: &Inner, execution: &mut dyn Execution, lease: &Lease) -> End {
    let silence = Duration::from_secs(inner.config.jobs.worker_silence_seconds);
    let why = tokio::select! {
        end = execution.ended() => return end,
        () = silent(inner, lease, silence) => {
            format!("the worker did not report for {} s and was killed", silence.as_secs())
        }
        () = stubborn(lease) => {
            if lease.begun() {
                format!("the worker did not stop within {} s and was killed", GRACE.as_secs())
            } else {
                "the attempt was stopped before its worker called".to_owned()
            }
        }
    };
    tracing::warn!(reason = why, "killing the worker");
    execution.kill(why).await
}

async fn silent(inner: &Inner, lease: &Lease, limit: Duration) {
    lease.silent_for(limit).await;
    // A worker on a cluster that has delivered its result has no more to report; its engine waits for its end.
    if inner.engine.outlives_server() && lease.delivered.is_cancelled() {
        std::future::pending().await
    }
}

async fn stubborn(lease: &Lease) {
    lease.stop.cancelled().await;
    // A worker that has not started cannot stop on its own.
    if lease.begun() {
        tokio::time::sleep(GRACE).await;
    }
}

#[cfg(test)]
mod tests;
