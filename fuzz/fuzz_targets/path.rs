//! Field paths, applied to a JSON message.
#![no_main]

use gleaner_fuzz::{recording::stretches, run, seeds};
use gleaner_recording::fuzzing::message;
use libfuzzer_sys::fuzz_target;

fuzz_target!(init: seeds::write("path"), |bytes: &[u8]| {
    let [path, json] = stretches(bytes);
    run(|| message(("json", ""), ("", b""), json, &String::from_utf8_lossy(path)));
});
