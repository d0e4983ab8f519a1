//! Messages of this dialect in a valid container, read as an episode.
#![no_main]

use std::sync::LazyLock;

use gleaner_fuzz::recording::{Channel, Dialect, dialects, wrap_and_read};
use gleaner_fuzz::{run, seeds};
use libfuzzer_sys::fuzz_target;

static DIALECT: LazyLock<(Dialect, Vec<Channel>)> = LazyLock::new(dialects::ros2);

fuzz_target!(init: seeds::write("ros2"), |bytes: &[u8]| run(|| wrap_and_read(DIALECT.0, &DIALECT.1, bytes)));
