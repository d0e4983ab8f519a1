//! A checkpoint: its header, and the load of a policy.
#![no_main]

use gleaner_fuzz::{run, seeds};
use gleaner_learn::{Policy, inspect};
use libfuzzer_sys::fuzz_target;

fuzz_target!(init: seeds::write("checkpoint"), |bytes: &[u8]| run(|| checkpoint(bytes)));

fn checkpoint(bytes: &[u8]) {
    let header = inspect(bytes);
    if let Ok(policy) = Policy::load(bytes) {
        assert_eq!(policy.shape(), &header.expect("a loaded policy has a header").shape);
    }
}
