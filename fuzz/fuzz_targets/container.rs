//! Any bytes as a recording: the container and its content.
#![no_main]

use gleaner_fuzz::{
    recording::{read, salvage_and_read},
    run, seeds,
};
use libfuzzer_sys::fuzz_target;

fuzz_target!(init: seeds::write("container"), |bytes: &[u8]| run(|| container(bytes)));

/// Salvaging writes a file, which is slow, so it runs for one input in eight.
fn container(bytes: &[u8]) {
    read(bytes);
    if bytes.len() % 8 == 0 {
        salvage_and_read(bytes);
    }
}
