//! Values as text in tables and lines: enum words, times, sizes, durations.

use std::fmt::Display;
use std::time::Duration;

use gleaner_client::Driven;
use jiff::Timestamp;
use jiff::tz::TimeZone;

/// The word of an enum value: its wire name without the enum's prefix, in lower case.
pub(crate) fn word(wire_name: &str, prefix: &str) -> String {
    wire_name.strip_prefix(prefix).unwrap_or(wire_name).to_ascii_lowercase()
}

macro_rules! word_of {
    ($function:ident, $kind:ident, $prefix:literal) => {
        pub(crate) fn $function(value: gleaner_proto::v1::$kind) -> String {
            word(value.as_str_name(), $prefix)
        }
    };
}

word_of!(outcome, Outcome, "OUTCOME_");
word_of!(severity, Severity, "SEVERITY_");
word_of!(role, Role, "ROLE_");
word_of!(job_kind, JobKind, "JOB_KIND_");
word_of!(job_state, JobState, "JOB_STATE_");

/// A wire timestamp, if it is set and valid.
pub(crate) fn timestamp(time: Option<&prost_types::Timestamp>) -> Option<Timestamp> {
    time.and_then(|time| Timestamp::new(time.seconds, time.nanos).ok())
}

/// Names for a message: the first ones, and how many more there are.
pub(crate) fn some(names: &[String]) -> String {
    const SHOWN: usize = 5;
    let shown = names.iter().take(SHOWN).cloned().collect::<Vec<_>>().join(", ");
    match names.len().saturating_sub(SHOWN) {
        0 => shown,
        more => format!("{shown} and {more} more"),
    }
}

/// A word of a command, quoted if a shell would change it.
pub(crate) fn shell_word(word: &str) -> String {
    let is_plain = |character: char| character.is_alphanumeric() || "-_./:=,+@%".contains(character);
    if !word.is_empty() && word.chars().all(is_plain) {
        return word.to_owned();
    }
    format!("'{}'", word.replace('\'', r"'\''"))
}

/// Local time to the minute; `-` when unset.
pub(crate) fn moment(time: Option<&prost_types::Timestamp>) -> String {
    let local = timestamp(time).map(|time| time.to_zoned(TimeZone::system()));
    local.map_or_else(|| "-".into(), |local| local.strftime("%Y-%m-%d %H:%M").to_string())
}

/// From one wire timestamp to another; `-` unless both are set.
pub(crate) fn between(from: Option<&prost_types::Timestamp>, to: Option<&prost_types::Timestamp>) -> String {
    let span = timestamp(from).zip(timestamp(to)).map(|(from, to)| to.duration_since(from));
    let span = span.and_then(|span| Duration::try_from(span).ok());
    span.map_or_else(|| "-".into(), duration)
}

pub(crate) fn duration(span: Duration) -> String {
    let seconds = span.as_secs();
    match seconds {
        0..10 => format!("{:.1} s", span.as_secs_f64()),
        10..60 => format!("{seconds} s"),
        60..3600 => format!("{} min {:02} s", seconds / 60, seconds % 60),
        _ => format!("{} h {:02} min", seconds / 3600, seconds / 60 % 60),
    }
}

/// How long the rest of some work takes: `about 2 min 10 s left`.
pub(crate) fn time_left(rest: Duration) -> String {
    if rest < Duration::from_secs(1) { "almost done".to_owned() } else { format!("about {} left", duration(rest)) }
}

/// A count with its noun: `1 study`, `2 studies`.
pub(crate) fn counted(count: impl TryInto<u64> + Display, one: &str, many: &str) -> String {
    let text = count.to_string();
    let is_one = count.try_into().is_ok_and(|count| count == 1);
    format!("{text} {}", if is_one { one } else { many })
}

pub(crate) fn milliseconds(span: Duration) -> String {
    format!("{:.1} ms", span.as_secs_f64() * 1e3)
}

#[expect(clippy::cast_precision_loss, reason = "shown with one decimal")]
pub(crate) fn megabytes(bytes: u64) -> f64 {
    bytes as f64 / 1e6
}

/// Bytes a second over a span, as MB/s; 0 for an empty span.
pub(crate) fn rate(bytes: u64, span: Duration) -> f64 {
    if span.is_zero() { 0.0 } else { megabytes(bytes) / span.as_secs_f64() }
}

/// A share of a whole in percent; `-` of nothing.
#[expect(clippy::cast_precision_loss, reason = "shown with one decimal")]
pub(crate) fn percent(part: u64, whole: u64) -> String {
    if whole == 0 { "-".into() } else { format!("{:.1} %", part as f64 / whole as f64 * 100.0) }
}

/// `153 of 200, 76.5 % (95 % interval 70.2 to 81.9)`.
pub(crate) fn successes(successes: u32, episodes: u32, (low, high): (f64, f64)) -> String {
    format!(
        "{successes} of {episodes}, {} (95 % interval {:.1} to {:.1})",
        percent(successes.into(), episodes.into()),
        low * 100.0,
        high * 100.0
    )
}

/// As [`successes`].
pub(crate) fn success_rate(driven: &Driven) -> String {
    let episodes = u32::try_from(driven.episodes.len()).unwrap_or(u32::MAX);
    successes(driven.successes(), episodes, driven.interval())
}

#[cfg(test)]
mod tests {
    use super::*;
    use gleaner_proto::v1::{JobState, Outcome};

    #[test]
    fn enum_values_are_shown_as_words() {
        assert_eq!(outcome(Outcome::Success), "success");
        assert_eq!(job_state(JobState::Queued), "queued");
    }

    #[test]
    fn durations_are_shown_in_a_fitting_unit() {
        let message: Vec<String> = [0.25, 42.7, 61.0, 7322.0].map(|s| duration(Duration::from_secs_f64(s))).into();
        assert_eq!(message, ["0.2 s", "42 s", "1 min 01 s", "2 h 02 min"]);
    }

    #[test]
    fn the_last_second_of_some_work_is_no_number() {
        let left = [0.0, 0.04, 0.999, 1.0, 130.0].map(|seconds| time_left(Duration::from_secs_f64(seconds)));
        assert_eq!(left[..3], ["almost done"; 3]);
        assert_eq!(left[3..], ["about 1.0 s left", "about 2 min 10 s left"]);
    }

    #[test]
    fn a_single_one_is_counted_in_the_singular() {
        let studies = [0_usize, 1, 2].map(|count| counted(count, "study", "studies"));
        assert_eq!(studies, ["0 studies", "1 study", "2 studies"]);
        assert_eq!(counted(1_u64, "step", "steps"), "1 step");
    }

    #[test]
    fn empty_evaluations_do_not_divide_by_zero() {
        assert_eq!(percent(0, 0), "-");
        assert_eq!(percent(1, 8), "12.5 %");
        assert!(rate(5, Duration::ZERO).abs() < f64::EPSILON);
    }

    #[test]
    fn times_need_both_ends() {
        let at = |seconds| Some(prost_types::Timestamp { seconds, nanos: 0 });
        assert_eq!(between(at(10).as_ref(), at(75).as_ref()), "1 min 05 s");
        assert_eq!(between(None, at(75).as_ref()), "-");
        assert_eq!(moment(None), "-");
    }
}
