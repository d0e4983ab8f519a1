//! When to stop, and that it ends: the signals that ask for it, and a limit on how long it takes.

use std::{
    io,
    thread::{Builder, park_timeout},
    time::{Duration, Instant},
};

use rustix::process::{Signal, getpid, kill_process};
use tokio::signal::unix::{SignalKind, signal};

/// Ends at the next SIGINT or SIGTERM, counted from now on and not from when it is awaited.
///
/// # Errors
/// When the signals cannot be listened to.
pub fn requested() -> io::Result<impl Future<Output = ()>> {
    let (mut interrupt, mut terminate) = (signal(SignalKind::interrupt())?, signal(SignalKind::terminate())?);
    Ok(async move {
        tokio::select! {
            _ = interrupt.recv() => {}
            _ = terminate.recv() => {}
        }
    })
}

/// Has this process outlive SIGHUP from now on: what reloads on it may come later, or never.
///
/// # Errors
/// When the signal cannot be listened to.
pub fn outlive_hangups() -> io::Result<()> {
    // Who has once listened to a signal is not ended by it any more.
    signal(SignalKind::hangup()).map(drop)
}

/// Has this process end within `limit`, whatever its clients, its disk or its threads do, and at once when it is asked
/// to stop a second time. What was acknowledged is on disk; what was not is put right at the next start, as after a
/// crash.
///
/// # Errors
/// When no thread can be had for it, or the signals cannot be listened to.
pub fn must_end_within(limit: Duration) -> io::Result<()> {
    let again = requested()?;
    tokio::spawn(async {
        again.await;
        end("asked to stop a second time")
    });
    let begun = Instant::now();
    // A thread: the runtime itself may be stuck.
    Builder::new().name("end".to_owned()).spawn(move || {
        while let Some(left) = limit.checked_sub(begun.elapsed()).filter(|left| !left.is_zero()) {
            park_timeout(left);
        }
        end("not everything ended in time")
    })?;
    Ok(())
}

/// Not by `exit`, whose handlers may wait for what does not end.
fn end(reason: &str) -> ! {
    tracing::error!(reason, "the server ends at once");
    if let Err(error) = kill_process(getpid(), Signal::KILL) {
        tracing::error!(%error, "the server cannot kill itself");
    }
    // The first process of a container cannot be killed from within it, not even by itself.
    std::process::abort();
}
