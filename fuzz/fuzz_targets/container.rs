//! Any bytes as a recording: the container, and everything behind it.
#![no_main]

use gleaner_fuzz::{
    judge,
    recording::{mend, read},
    seeds,
};
use libfuzzer_sys::fuzz_target;

fuzz_target!(init: seeds::write("container"), |bytes: &[u8]| judge(|| container(bytes)));

/// Mending writes a file, which is slow: one input in eight.
fn container(bytes: &[u8]) {
    read(bytes);
    if bytes.len() % 8 == 0 {
        mend(bytes);
    }
}
