//! Shared parts of the fuzz targets: limits on the cost of an input, recordings with the messages of an input, and the task
//! of those recordings.

#[cfg(feature = "datasets")]
pub mod dataset;
pub mod recording;
pub mod seeds;
pub mod task;

use std::alloc::System;
use std::sync::Once;
use std::time::Duration;

use cap::Cap;
use cpu_time::ProcessTime;

/// Maximum memory of an input, in bytes.
const MOST_BYTES: usize = 512 << 20;

/// A larger allocation ends the target, even if the memory is never used.
#[global_allocator]
static ALLOCATOR: Cap<System> = Cap::new(System, MOST_BYTES);

/// Maximum processor time of an input on all threads. Elapsed time would include other load on the machine.
const MOST_TIME: Duration = Duration::from_secs(2);

/// Runs one input; panics if it takes too long.
pub fn run(input: impl FnOnce()) {
    static HOOK: Once = Once::new();
    HOOK.call_once(ignore_caught_panics);
    let begun = ProcessTime::now();
    input();
    let spent = begun.elapsed();
    assert!(spent < MOST_TIME, "the input took {spent:?}");
}

/// Crates whose panics are known and caught by their callers; any other panic ends the target.
const CAUGHT: [&str; 6] = ["/arrow-", "/hdf5-pure-", "/mcap-", "/parquet-", "/prost-reflect-", "/re_mp4-"];

fn ignore_caught_panics() {
    let end = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        let known = |at: &std::panic::Location<'_>| CAUGHT.iter().any(|part| at.file().contains(part));
        if !panic.location().is_some_and(known) {
            end(panic);
        }
    }));
}

/// Removes bytes from the front of an input; fewer at its end.
pub fn take<'a>(rest: &mut &'a [u8], count: usize) -> &'a [u8] {
    let (head, tail) = rest.split_at(count.min(rest.len()));
    *rest = tail;
    head
}

/// Removes a number of up to eight little-endian bytes from the front of an input.
pub fn number(rest: &mut &[u8], bytes: usize) -> u64 {
    take(rest, bytes).iter().rev().fold(0, |so_far, &byte| so_far << 8 | u64::from(byte))
}

/// Removes a stretch from the front of an input: two bytes of length, then the bytes.
pub fn stretch<'a>(rest: &mut &'a [u8]) -> &'a [u8] {
    let count = number(rest, 2) as usize;
    take(rest, count)
}

/// Appends a stretch in the format of [`stretch`].
pub fn append(out: &mut Vec<u8>, stretch: &[u8]) {
    let stretch = &stretch[..stretch.len().min(usize::from(u16::MAX))];
    out.extend((stretch.len() as u16).to_le_bytes());
    out.extend(stretch);
}
