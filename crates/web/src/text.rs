//! Numbers, sizes and times in readable form.

use std::time::Duration;

use gleaner_core::time::Millis;
use jiff::{Timestamp, tz::TimeZone};

/// `12,345`.
pub(super) fn count(number: u64) -> String {
    let digits = number.to_string();
    let mut out = String::with_capacity(digits.len() + digits.len() / 3);
    for (at, digit) in digits.char_indices() {
        if at > 0 && (digits.len() - at).is_multiple_of(3) {
            out.push(',');
        }
        out.push(digit);
    }
    out
}

/// `1 episode`, `2 episodes`.
pub(super) fn counted(number: u64, one: &str) -> String {
    format!("{} {one}{}", count(number), if number == 1 { "" } else { "s" })
}

/// `1.4 GiB`.
#[expect(clippy::cast_precision_loss, reason = "for reading")]
pub(super) fn bytes(number: u64) -> String {
    let units = ["B", "KiB", "MiB", "GiB", "TiB"];
    let mut size = number as f64;
    let mut unit = 0;
    while size >= 1024.0 && unit + 1 < units.len() {
        size /= 1024.0;
        unit += 1;
    }
    let places = usize::from(unit > 0 && size < 100.0);
    format!("{size:.places$} {}", units.get(unit).copied().unwrap_or_default())
}

/// `8.2 s`, `3 min 20 s`, `2 h 05 min`.
pub(super) fn seconds(seconds: f64) -> String {
    let whole = Duration::try_from_secs_f64(seconds.max(0.0)).unwrap_or_default().as_secs();
    match whole {
        0..60 => format!("{seconds:.1} s"),
        60..3600 => format!("{} min {:02} s", whole / 60, whole % 60),
        3600.. => format!("{} h {:02} min", whole / 3600, whole % 3600 / 60),
    }
}

/// `31.4 %` of a part; a dash for an empty total.
#[expect(clippy::cast_precision_loss, reason = "for reading")]
pub(super) fn share(part: u64, of: u64) -> String {
    if of == 0 { "–".to_owned() } else { format!("{:.1} %", 100.0 * part as f64 / of as f64) }
}

/// `2026-11-21 23:50`, UTC.
pub(super) fn time(at: Millis) -> String {
    Timestamp::from_millisecond(at.0)
        .map(|at| at.to_zoned(TimeZone::UTC).strftime("%Y-%m-%d %H:%M").to_string())
        .unwrap_or_default()
}

/// For programs: `2026-11-21T23:50:12.345Z`.
pub(super) fn stamp(at: Millis) -> String {
    Timestamp::from_millisecond(at.0).map(|at| at.to_string()).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_formatted() {
        assert_eq!(
            ["0", "999", "1,000", "1,234,567"],
            [0, 999, 1000, 1_234_567].map(count).each_ref().map(String::as_str)
        );
        assert_eq!((counted(1, "step"), counted(2, "step")), ("1 step".to_owned(), "2 steps".to_owned()));
        assert_eq!([bytes(0), bytes(1536), bytes(5 << 30), bytes(200 << 20)], ["0 B", "1.5 KiB", "5.0 GiB", "200 MiB"]);
        assert_eq!(
            [seconds(-1.0), seconds(8.24), seconds(200.0), seconds(7500.0)][1..],
            ["8.2 s", "3 min 20 s", "2 h 05 min"]
        );
        assert_eq!((share(1, 3), share(0, 0)), ("33.3 %".to_owned(), "–".to_owned()));
        assert_eq!(time(Millis(1_800_000_000_000)), "2027-01-15 08:00");
        assert_eq!(stamp(Millis(1_800_000_000_123)), "2027-01-15T08:00:00.123Z");
    }
}
