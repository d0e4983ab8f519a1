//! What the fuzz targets share: limits on what an input may cost, recordings made of an input's messages, and the task
//! they are read by.

pub mod recording;
pub mod seeds;
pub mod task;

use std::alloc::System;
use std::sync::Once;
use std::time::Duration;

use cap::Cap;
use cpu_time::ProcessTime;

/// Most memory that an input may take, over what the fuzzer has itself.
const MOST_BYTES: usize = 512 << 20;

/// An input that asks for more ends the target, even if it would never have touched it.
#[global_allocator]
static ALLOCATOR: Cap<System> = Cap::new(System, MOST_BYTES);

/// Most processor time that an input may take, on whatever threads it runs. The wall's clock would count what else the
/// machine does.
const MOST_TIME: Duration = Duration::from_secs(2);

/// Runs one input, and ends the target when it takes too long.
pub fn judge(input: impl FnOnce()) {
    static HOOK: Once = Once::new();
    HOOK.call_once(forgive);
    let begun = ProcessTime::now();
    input();
    let spent = begun.elapsed();
    assert!(spent < MOST_TIME, "the input took {spent:?}");
}

/// Crates whose panics are known and caught where they are called; any other panic ends the target.
const FORGIVEN: [&str; 2] = ["/mcap-", "/prost-reflect-"];

fn forgive() {
    let end = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        let known = |at: &std::panic::Location<'_>| FORGIVEN.iter().any(|part| at.file().contains(part));
        if !panic.location().is_some_and(known) {
            end(panic);
        }
    }));
}

/// Takes a number of bytes off the front of an input; less at its end.
pub fn take<'a>(rest: &mut &'a [u8], count: usize) -> &'a [u8] {
    let (head, tail) = rest.split_at(count.min(rest.len()));
    *rest = tail;
    head
}

/// A number of up to eight little-endian bytes from the front of an input.
pub fn number(rest: &mut &[u8], bytes: usize) -> u64 {
    take(rest, bytes).iter().rev().fold(0, |so_far, &byte| so_far << 8 | u64::from(byte))
}

/// A stretch of an input: two bytes of length, then that many.
pub fn stretch<'a>(rest: &mut &'a [u8]) -> &'a [u8] {
    let count = number(rest, 2) as usize;
    take(rest, count)
}

/// Puts a stretch behind another, as [`stretch`] takes it.
pub fn append(out: &mut Vec<u8>, stretch: &[u8]) {
    let stretch = &stretch[..stretch.len().min(usize::from(u16::MAX))];
    out.extend((stretch.len() as u16).to_le_bytes());
    out.extend(stretch);
}
