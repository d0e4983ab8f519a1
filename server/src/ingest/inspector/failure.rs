//! The errors of an inspection that has no usable recording. Must not start or stop a child.

use std::{os::unix::process::ExitStatusExt as _, process::ExitStatus};

use gleaner_inspector::Order;
use rustix::process::Signal;

use crate::{error::Error, file_limit::largest_file};

/// An error travels in an HTTP/2 header, where non-ASCII takes three bytes for one and 16 KiB is common.
const REFUSAL_BYTES: usize = 3000;

/// The exit code of a Rust program that panicked.
const PANICKED: i32 = 101;
const BROKE_READER: &str = "the file is damaged and its reader crashed; record the episode again";

/// The task cannot use the recording.
pub(super) fn refused(reason: &str) -> Error {
    Error::invalid("recording", shortened(reason))
}

/// The child used its time up.
pub(super) fn took_too_long(seconds: u64) -> Error {
    Error::invalid(
        "recording",
        format!(
            "reading it takes more than {seconds} s; record shorter episodes, or raise --inspect-seconds at the server"
        ),
    )
}

/// The cause of death of a child without a verdict.
pub(super) fn broken(order: &Order, status: ExitStatus, stderr_text: &str, seconds: u64) -> Error {
    tracing::warn!(inspect.status = %status, inspect.stderr = stderr_text, "an inspection failed");
    let (memory, written) = (order.memory_bytes >> 20, order.most_written());
    match status.signal().and_then(Signal::from_named_raw) {
        Some(Signal::XCPU) => took_too_long(seconds),
        Some(Signal::XFSZ) if largest_file().is_some_and(|most| most < written) => Error::exhausted(
            "the recording's decoded images take more than the file size limit of the server's process: raise it \
             there (`ulimit -f`, LimitFSIZE= of its service), then push the file again",
        ),
        Some(Signal::XFSZ) => Error::invalid(
            "recording",
            format!(
                "its decoded images take more than {} MiB; record shorter episodes or smaller images, or raise \
                 --inspect-memory-bytes at the server",
                written >> 20
            ),
        ),
        // The exit status after a failed allocation.
        Some(Signal::ABORT) => Error::invalid(
            "recording",
            format!(
                "reading it takes more than {memory} MiB of memory: the file is damaged, or the episode too long. \
                 Record it again, or raise --inspect-memory-bytes at the server"
            ),
        ),
        // Signals of people and service managers, and of the kernel when the machine is out of memory: not caused
        // by the recording, which has limits of its own.
        Some(Signal::HUP | Signal::INT | Signal::QUIT | Signal::TERM | Signal::KILL) => {
            Error::unavailable("the recording's inspection was stopped; retry")
        }
        Some(_) => Error::invalid("recording", BROKE_READER),
        None if status.code() == Some(PANICKED) => Error::invalid("recording", BROKE_READER),
        None => Error::internal("inspecting a recording", format!("{status}: {stderr_text}")),
    }
}

fn shortened(text: &str) -> String {
    if text.len() <= REFUSAL_BYTES {
        return text.to_owned();
    }
    let end = text.floor_char_boundary(REFUSAL_BYTES);
    format!("{} … (and more)", text.get(..end).unwrap_or_default())
}
