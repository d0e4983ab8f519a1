//! A checkpoint: its header, and the policy that it may hold.
#![no_main]

use gleaner_fuzz::{judge, seeds};
use gleaner_learn::{Policy, inspect};
use libfuzzer_sys::fuzz_target;

fuzz_target!(init: seeds::write("checkpoint"), |bytes: &[u8]| judge(|| checkpoint(bytes)));

fn checkpoint(bytes: &[u8]) {
    let header = inspect(bytes);
    if let Ok(policy) = Policy::load(bytes) {
        assert_eq!(policy.shape(), &header.expect("what loads has a header").shape);
    }
}
