//! Rates that were measured, each with its source. Another machine has others: trust the order of size.

use crate::codec::Codec;

/// Pixels of a picture of 480 × 640, at which cameras were measured.
const PICTURE: f64 = 480.0 * 640.0;

/// Bytes for each recorded pixel. JPEG: 14.7 GB for 216,000 pictures (decision 0036). Video: 150 pictures of a noisy scene
/// (docs/video.md; H.264 is x264's `ultrafast`, which recorders use).
pub(crate) fn bytes_a_pixel(codec: Codec) -> f64 {
    let kilobytes = match codec {
        Codec::Jpeg => 68.0,
        Codec::H264 => 44.0,
        Codec::H265 => 11.0,
        Codec::Av1 => 6.0,
    };
    kilobytes * 1000.0 / PICTURE
}

/// Recorded pixels that one processor decodes, resizes and packs in a second. JPEG: 216,000 pictures in 743 s (decision
/// 0036). Video: docs/video.md.
pub(crate) fn pixels_a_second(codec: Codec) -> f64 {
    let pictures = match codec {
        Codec::Jpeg => 291.0,
        Codec::H264 => 76.0,
        Codec::H265 => 85.0,
        Codec::Av1 => 98.0,
    };
    pictures * PICTURE
}

/// Bytes of the cache for each pixel at the size of learning: 5.6 GB for 216,000 pictures of 128 × 128 (decision 0036).
pub(crate) const CACHE_BYTES_A_PIXEL: f64 = 5.6e9 / 216_000.0 / (128.0 * 128.0);

/// Bytes of the database for each scored segment: w in 8, q in 4, the match in 8 and three distances in 12.
pub(crate) const ROW_BYTES_A_SEGMENT: f64 = 32.0;

/// Bytes of the database for each episode: its row, labels, report and audit entries, rounded up.
pub(crate) const ROW_BYTES_AN_EPISODE: f64 = 4000.0;

/// Bytes of the server's memory for each segment of the newest run: 646 MiB less the 133 of its libraries and 16 more of
/// its start for 10 million segments (docs/scale.md).
pub(crate) const MEMORY_BYTES_A_SEGMENT: f64 = (646.0 - 149.0) * 1_048_576.0 / 1e7;

/// Values of pairs of segments that one processor compares in a second: 4,000 × 100,000 pairs of 384 values in 1.09 s
/// (docs/results/speed.md). Wider rows are compared faster: 6,000 × 4,000 pairs of 4,032 values in 0.34 s.
pub(crate) const COMPARED_VALUES_A_SECOND: f64 = 4000.0 * 100_000.0 * 384.0 / 1.09;

/// Values of a segment for each camera, by raw observations at the default length (docs/results/speed.md).
pub(crate) const VALUES_A_CAMERA: f64 = 1344.0;

/// Actions a second that a model of `tiny` size gives 16 sessions, JPEG pictures, on two processors
/// (docs/results/speed.md, "Serving").
pub(crate) const ACTIONS_A_SECOND: f64 = 3570.0 / 2.0;

/// Seconds from the start of a training to its first step, for each episode read from a disk (docs/scale.md).
pub(crate) const START_SECONDS_AN_EPISODE: f64 = 10.3 / 100_000.0;

/// Durable writes of one row a second (one row in 0.65 ms).
pub(crate) const WRITES_A_SECOND: f64 = 1.0 / 0.000_65;

/// Durable writes for each episode: upload, parts, row, labels, audit entries.
pub(crate) const WRITES_AN_EPISODE: f64 = 8.0;
