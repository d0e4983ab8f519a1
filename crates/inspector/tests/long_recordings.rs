//! Long recordings under a low limit on memory: an inspection holds a few pictures of a camera at a time, and writes the same
//! cache with any number of threads.

#![allow(clippy::unwrap_used)]

mod long;

use long::Long;

#[test]
fn memory_of_an_inspection_does_not_follow_the_pictures() {
    Long { cameras: 2, height: 64, width: 64, learned: None, rate_hz: 30, steps: 3000, films: &[] }
        .passes_within(24 << 20, &[1, 4]);
}

/// Streams without reordering: each packet has the stamp of its picture.
#[test]
fn memory_of_an_inspection_does_not_follow_the_pictures_of_video() {
    let films = &["h264_baseline", "h265_low_delay", "av1_aom"];
    Long { cameras: films.len(), height: 48, width: 64, learned: None, rate_hz: 30, steps: 3000, films }
        .passes_within(32 << 20, &[1, 4]);
}
