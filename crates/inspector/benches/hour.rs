//! Whether the recording of a lab passes an inspection within 512 MiB: four cameras of 480 × 640 at 15 Hz, learned from at
//! 128 × 128, for as many seconds as its argument gives (60), on one thread and on as many as there are processors.
//! `make bench-hour` takes most of an hour, and about 20 GB in the temporary folder.

#![allow(clippy::print_stdout, clippy::unwrap_used)]

#[path = "../tests/long/mod.rs"]
mod long;

use std::time::Instant;

use long::Long;

fn main() {
    let seconds = std::env::args().find_map(|argument| argument.parse::<u32>().ok()).unwrap_or(60);
    let processors = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    let begun = Instant::now();
    let threads = [1, processors];
    let steps = 15 * seconds;
    let hour = Long { cameras: 4, height: 480, width: 640, learned: Some(128), rate_hz: 15, steps, films: &[] };
    for (threads, took) in threads.iter().zip(hour.passes_within(512 << 20, &threads)) {
        println!("{seconds} s of recording inspected in {took:.1} s on {threads} threads");
    }
    println!("written, inspected twice and read in {:.0} s", begun.elapsed().as_secs_f64());
}
