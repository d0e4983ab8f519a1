//! Every request of a client or a worker, decoded and converted.
#![no_main]

use gleaner_fuzz::{run, seeds};
use gleaner_server::fuzzing::message;
use libfuzzer_sys::fuzz_target;

fuzz_target!(init: seeds::write("wire"), |bytes: &[u8]| {
    if let Some((&kind, bytes)) = bytes.split_first() {
        run(|| message(kind, bytes));
    }
});
