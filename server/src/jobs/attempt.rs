//! One attempt of a job: its worker process from start to end, and the meaning of that end.

use std::{io::Write as _, pin::pin, time::Duration};

use bytes::Bytes;
use gleaner_recording::printable::Escape;
use tokio::{io::AsyncRead, process::Child};
use tracing::Instrument as _;

use super::{Inner, lease::Lease, log::Log, process, token::Issuer};
use crate::{
    domain::{attempt::AttemptEnd, job::Job},
    telemetry::memory,
};

/// Longest time from a request to stop until the worker is killed.
const GRACE: Duration = Duration::from_secs(10);
/// Longest wait for the rest of an ended worker's output.
const LAST_OUTPUT: Duration = Duration::from_secs(2);

/// Runs the attempt that has claimed `job`.
pub(super) async fn run(inner: &Inner, job: Job, issuer: Issuer) {
    let span = tracing::info_span!("attempt", job.id = %job.id, job.kind = job.spec.kind().as_str(), job.attempt = job.attempt);
    async {
        let attempt = issuer.attempt(&job.id);
        let lease = inner.leases.grant(&attempt);
        tracing::info!("attempt started");
        let mut log = Log::of(&inner.config.data_dir, &job.id).await;
        log.note(&format!("attempt {} of {} begins", job.attempt, job.max_attempts)).await;
        let end = match process::start(&inner.config, inner.server, &issuer.token(&job.id)) {
            Ok(mut child) => {
                crate::fail_point::pass("worker.started");
                let memory = memory::of_worker(child.id().unwrap_or(0), job.spec.kind().as_str());
                let output = child.stderr.take();
                tokio::select! {
                    end = with_output(watch_over(inner, child, &lease), &mut log, output) => end,
                    never = memory => match never {},
                }
            }
            Err(error) => AttemptEnd::Broken(format!("the worker could not be started: {error}")),
        };
        // A requested stop is the reason however the process ended, and on a full disk no attempt can continue.
        let stopped = lease.stop.is_cancelled() || inner.blobs.is_full();
        let end = if stopped { AttemptEnd::Stopped } else { end };
        inner.end_with_retries(&attempt, &end).await;
        inner.leases.end(&attempt);
        log.note(&standing(inner, &job).await).await;
    }
    .instrument(span)
    .await;
}

/// The output of `end`, once all of the worker's output before it is logged.
async fn with_output(
    end: impl Future<Output = AttemptEnd>,
    log: &mut Log,
    output: Option<impl AsyncRead + Unpin>,
) -> AttemptEnd {
    let Some(output) = output else { return end.await };
    let (mut end, mut following) = (pin!(end), pin!(log.follow(output, pass_on)));
    tokio::select! {
        end = &mut end => {
            // The pipe closes with the worker; if another process still holds it open, the wait ends after
            // `LAST_WORDS`.
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

/// Waits for the process to end, and kills it when it is silent or ignores a request to stop.
async fn watch_over(inner: &Inner, mut child: Child, lease: &Lease) -> AttemptEnd {
    let silence = Duration::from_secs(inner.config.jobs.worker_silence_seconds);
    let why = tokio::select! {
        status = child.wait() => return match status {
            Ok(status) => AttemptEnd::Broken(process::describe(status)),
            Err(error) => AttemptEnd::Broken(format!("the worker was lost: {error}")),
        },
        () = lease.silent_for(silence) => format!("the worker did not report for {} s and was killed", silence.as_secs()),
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

#[cfg(test)]
mod tests {
    use tokio::io::AsyncWriteExt as _;

    use super::*;
    use crate::{domain::id::JobId, jobs::log};

    /// The log of a worker that writes these last words and ends; `lets_go`: its end of the pipe closes too.
    async fn log_of(last_output: &[u8], lets_go: bool) -> String {
        let (dir, job) = (tempfile::tempdir().unwrap(), JobId::new());
        let mut log = Log::of(dir.path(), &job).await;
        let (mut worker, output) = tokio::io::duplex(4096);
        let end = async {
            worker.write_all(last_output).await.unwrap();
            if lets_go {
                drop(worker);
            } else {
                std::mem::forget(worker);
            }
            AttemptEnd::Broken("it ended".to_owned())
        };
        assert_eq!(with_output(end, &mut log, Some(output)).await, AttemptEnd::Broken("it ended".to_owned()));
        log::read(dir.path(), &job, u64::MAX).await.unwrap()
    }

    #[tokio::test]
    async fn the_last_output_of_a_worker_is_kept() {
        assert_eq!(log_of(b"one\nlast", true).await, "one\nlast\n");
        assert_eq!(log_of(b"", true).await, "");
    }

    #[tokio::test]
    async fn a_pipe_that_stays_open_is_not_waited_for() {
        assert_eq!(log_of(b"one\nhalf", false).await, "one\n");
    }
}
