//! A schema and a message of this encoding.
#![no_main]

use gleaner_fuzz::{recording::stretches, run, seeds};
use gleaner_recording::fuzzing::message;
use libfuzzer_sys::fuzz_target;

fuzz_target!(init: seeds::write("cdr"), |bytes: &[u8]| {
    let [name, path, schema, data] = stretches(bytes);
    let [name, path] = [name, path].map(String::from_utf8_lossy);
    run(|| message(("cdr", "ros2msg"), (&name, schema), data, &path));
});
