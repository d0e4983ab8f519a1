//! Datasets of LeRobot and robomimic with one damaged file, described and converted as an import does.
#![no_main]

use gleaner_fuzz::{dataset, run, seeds};
use libfuzzer_sys::fuzz_target;

fuzz_target!(init: seeds::write("dataset"), |bytes: &[u8]| run(|| dataset::read(bytes)));
