//! Episodes by ranges of time that a person states.

use serde::{Deserialize, Serialize};

use super::Span;
use crate::error::RecordingError;

const SECOND: f64 = 1e9;
/// A range may end this many seconds after the recording, which people state in rounded numbers.
const ROUNDING_S: f64 = 0.01;

/// The time of an episode, in seconds from the first message of the recording; the end is not part of it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TimeRange {
    /// Where it begins.
    pub start_s: f64,
    /// Where it ends.
    pub end_s: f64,
    /// Whether it succeeded, if that is stated.
    pub success: Option<bool>,
}

impl TimeRange {
    fn shown(&self) -> String {
        format!("the range {} to {} s", self.start_s, self.end_s)
    }
}

/// The spans of ranges in the recording whose messages have these first and last times, in their order.
///
/// # Errors
/// [`RecordingError::Ranges`] names the first range that ends before it begins, leaves the recording or overlaps another.
pub(super) fn spans(ranges: &[TimeRange], (first, last): (u64, u64)) -> Result<Vec<Span>, RecordingError> {
    #[expect(clippy::cast_precision_loss, reason = "nanoseconds of a recording are far below 2^53")]
    let length_s = last.saturating_sub(first) as f64 / SECOND;
    let wrong = |problem: String| RecordingError::Ranges { problem };
    let mut sorted: Vec<&TimeRange> = ranges.iter().collect();
    sorted.sort_by(|one, other| one.start_s.total_cmp(&other.start_s));
    for range in &sorted {
        let shown = range.shown();
        // A number that is not finite is in no order.
        if range.start_s.partial_cmp(&range.end_s) != Some(std::cmp::Ordering::Less) {
            return Err(wrong(format!("{shown} does not end after it begins; correct it")));
        }
        if range.start_s < 0.0 || range.start_s >= length_s || range.end_s > length_s + ROUNDING_S {
            return Err(wrong(format!(
                "{shown} is outside of the recording, whose messages take {length_s:.2} s; times count from its first message"
            )));
        }
    }
    if let Some(pair) = sorted.windows(2).find(|pair| pair[1].start_s < pair[0].end_s) {
        return Err(wrong(format!("{} overlaps {}; correct one of them", pair[1].shown(), pair[0].shown())));
    }
    let time = |seconds: f64| {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "within the recording")]
        let offset = (seconds * SECOND).round() as u64;
        first.saturating_add(offset)
    };
    let span = |range: &&TimeRange| Span {
        begin: time(range.start_s),
        // A range to the recording's end has its last message too.
        end: if range.end_s + ROUNDING_S > length_s { u64::MAX } else { time(range.end_s) },
        success: range.success,
    };
    Ok(sorted.iter().map(span).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn range(start_s: f64, end_s: f64) -> TimeRange {
        TimeRange { start_s, end_s, success: None }
    }

    #[test]
    fn ranges_are_sorted_and_the_last_has_the_last_message() {
        let found = spans(&[range(2.5, 4.0), range(0.0, 2.5)], (1_000, 4_000_001_000)).unwrap();
        let times: Vec<(u64, u64)> = found.iter().map(|span| (span.begin, span.end)).collect();
        assert_eq!(times, [(1_000, 2_500_001_000), (2_500_001_000, u64::MAX)]);
    }

    #[test]
    fn ranges_that_cannot_be_are_refused() {
        let problem = |ranges: &[TimeRange]| spans(ranges, (7, 10_000_000_007)).unwrap_err().to_string();
        for (start, end) in [(3.0, 3.0), (3.0, 2.0), (f64::NAN, 1.0), (0.0, f64::NAN)] {
            assert!(problem(&[range(start, end)]).contains("does not end after it begins"), "{start} {end}");
        }
        for (start, end) in [(-0.1, 2.0), (10.0, 11.0), (9.0, 10.5), (0.0, f64::INFINITY)] {
            let problem = problem(&[range(start, end)]);
            assert!(problem.contains("outside of the recording") && problem.contains("10.00 s"), "{problem}");
        }
        let overlap = problem(&[range(5.0, 7.0), range(0.0, 1.0), range(6.9, 8.0)]);
        assert!(overlap.contains("the range 6.9 to 8 s overlaps the range 5 to 7 s"), "{overlap}");
    }
}
