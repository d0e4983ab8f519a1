//! A robot's observation: the message, its checks and its images.
#![no_main]

use std::sync::LazyLock;

use gleaner_fuzz::{run, seeds};
use gleaner_server::fuzzing::observation;
use libfuzzer_sys::fuzz_target;
use tokio::runtime::{Builder, Runtime};

static RUNTIME: LazyLock<Runtime> =
    LazyLock::new(|| Builder::new_current_thread().build().expect("the runtime starts"));

fuzz_target!(init: seeds::write("observation"), |bytes: &[u8]| run(|| RUNTIME.block_on(observation(bytes))));
