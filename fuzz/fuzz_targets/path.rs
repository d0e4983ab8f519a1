//! Field paths, and what they pick out of a JSON message.
#![no_main]

use gleaner_fuzz::{judge, recording::stretches, seeds};
use gleaner_recording::fuzzing::message;
use libfuzzer_sys::fuzz_target;

fuzz_target!(init: seeds::write("path"), |bytes: &[u8]| {
    let [path, json] = stretches(bytes);
    judge(|| message(("json", ""), ("", b""), json, &String::from_utf8_lossy(path)));
});
