//! The largest file that the system lets this process write (RLIMIT_FSIZE: `ulimit -f`, systemd's LimitFSIZE).

use std::io;

use rustix::process::{Resource, Signal, getrlimit};
use tokio::signal::unix::{SignalKind, signal};

/// The largest file that this process may write, in bytes; `None` without a limit.
pub fn largest_file() -> Option<u64> {
    getrlimit(Resource::Fsize).current
}

/// Turns the signal of a write beyond the limit (SIGXFSZ), which would end this process, into an error of that write.
/// Child processes are not affected. Must be called within a runtime.
///
/// # Errors
/// When the signal cannot be handled.
pub fn survive_limit() -> io::Result<()> {
    // A signal with a handler no longer ends the process.
    signal(SignalKind::from_raw(Signal::XFSZ.as_raw())).map(drop)
}
