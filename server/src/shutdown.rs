//! Stopping the server: the signals that request it, and a limit on how long it takes.

use std::{
    io,
    thread::{Builder, park_timeout},
    time::{Duration, Instant},
};

use rustix::process::{Signal, getpid, kill_process};
use tokio::signal::unix::{SignalKind, signal};

/// Completes at the next SIGINT or SIGTERM, counted from the call and not from the first poll.
///
/// # Errors
/// When the signal handlers cannot be installed.
pub fn requested() -> io::Result<impl Future<Output = ()>> {
    let (mut interrupt, mut terminate) = (signal(SignalKind::interrupt())?, signal(SignalKind::terminate())?);
    Ok(async move {
        tokio::select! {
            _ = interrupt.recv() => {}
            _ = terminate.recv() => {}
        }
    })
}

/// Makes this process ignore SIGHUP from now on: the handler that reloads on it may be installed later, or never.
///
/// # Errors
/// When the signal handler cannot be installed.
pub fn ignore_hangups() -> io::Result<()> {
    // Once handled, a signal no longer ends the process by default.
    signal(SignalKind::hangup()).map(drop)
}

/// Ends this process within `limit`, whatever its clients, its disk or its threads do, and at once on a second request
/// to stop. Acknowledged data is on disk; the rest is recovered at the next start, as after a crash.
///
/// # Errors
/// When the thread cannot be started, or the signal handlers cannot be installed.
pub fn must_end_within(limit: Duration) -> io::Result<()> {
    let again = requested()?;
    tokio::spawn(async {
        again.await;
        end("a second request to stop arrived")
    });
    let begun = Instant::now();
    // A thread, because the runtime itself may be stuck.
    Builder::new().name("end".to_owned()).spawn(move || {
        while let Some(left) = limit.checked_sub(begun.elapsed()).filter(|left| !left.is_zero()) {
            park_timeout(left);
        }
        end("some tasks did not end in time")
    })?;
    Ok(())
}

/// Ends the process without `exit`, whose handlers may wait for a stuck thread.
fn end(reason: &str) -> ! {
    tracing::error!(reason, "the server exits immediately");
    if let Err(error) = kill_process(getpid(), Signal::KILL) {
        tracing::error!(%error, "SIGKILL cannot be sent to this process");
    }
    // SIGKILL has no effect on the first process of a container when it comes from within the container.
    std::process::abort();
}
