//! Steps that are off the task's rate: the two corrections of the task.
//!
//! Works on reports alone.

use gleaner_core::{Report, TaskSpec};

/// Rates this near to that of the task, as a share of it, are its rate.
const SHARE: f64 = 0.2;
/// A rate this near to a whole number is that number.
const WHOLE: f64 = 0.03;
/// Most topics that a correction names.
const NAMED: usize = 3;

/// Both corrections of a recording that is off the task's rate: the measured rate, or a clock that has the task's rate, with
/// the topics that have it. `measured` is the rate of this recording, or the middle one of several.
#[must_use]
pub fn rate_corrections(spec: &TaskSpec, report: &Report, measured: f64) -> String {
    let mapping = spec.mappings.iter().find(|mapping| mapping.name == report.mapping);
    let clock = mapping.and_then(|mapping| mapping.clock_topic(spec));
    let topics = topics_of_rate(spec, report, clock);
    let such = if topics.is_empty() { String::new() } else { format!(", such as {}", topics.join(" or ")) };
    format!(
        "the steps of {} come at {measured:.1} Hz and the task has {} Hz: set `rate_hz = {:?}`, or in the mapping `{}` as \
         `clock` a topic of {} Hz{such}",
        clock.unwrap_or("the clock"),
        spec.rate_hz,
        rounded_rate(measured),
        report.mapping,
        spec.rate_hz
    )
}

/// A measured rate as a task has it: a whole number if it is near to one.
#[must_use]
pub fn rounded_rate(rate: f64) -> f64 {
    let whole = rate.round();
    if whole >= 1.0 && (rate / whole - 1.0).abs() <= WHOLE { whole } else { (rate * 100.0).round().max(1.0) / 100.0 }
}

/// The topics of the mapping that come about as often as the task's rate, with their rates.
fn topics_of_rate(spec: &TaskSpec, report: &Report, clock: Option<&str>) -> Vec<String> {
    let seconds = report.duration_ns as f64 / 1e9;
    let used = report.topics.iter().filter(|topic| topic.used && Some(topic.topic.as_str()) != clock);
    let rated = used.map(|topic| (topic.topic.as_str(), topic.messages.saturating_sub(1) as f64 / seconds));
    let near = rated.filter(|(_, rate)| seconds > 0.0 && (rate / spec.rate_hz - 1.0).abs() <= SHARE);
    near.take(NAMED).map(|(topic, rate)| format!("{topic} (about {rate:.0} Hz)")).collect()
}

#[cfg(test)]
mod tests {
    use gleaner_core::TopicReport;

    use super::*;

    fn spec() -> TaskSpec {
        serde_json::from_value(serde_json::json!({
            "name": "t", "rate_hz": 20.0,
            "proprioception": [{ "name": "joints", "size": 2 }], "action": [{ "name": "delta", "size": 2 }],
            "mappings": [{ "name": "json", "fields": [
                { "field": "joints", "topic": "/joints", "paths": ["q"] },
                { "field": "delta", "topic": "/cmd", "paths": ["v"] },
            ] }],
        }))
        .unwrap()
    }

    /// A recording of ten seconds.
    fn report() -> Report {
        let mut report = Report { mapping: "json".into(), duration_ns: 10_000_000_000, ..Report::default() };
        report.topics = [("/cmd", 149, true), ("/front", 201, true), ("/joints", 501, true), ("/rosout", 201, false)]
            .map(|(topic, messages, used)| TopicReport {
                topic: topic.into(),
                schema: String::new(),
                encoding: "json".into(),
                messages,
                used,
            })
            .into();
        report
    }

    #[test]
    fn both_corrections_are_named_with_the_measured_rate_and_the_topics_of_the_tasks_rate() {
        assert_eq!(
            rate_corrections(&spec(), &report(), 14.9),
            "the steps of /cmd come at 14.9 Hz and the task has 20 Hz: set `rate_hz = 15.0`, or in the mapping `json` as \
             `clock` a topic of 20 Hz, such as /front (about 20 Hz)"
        );
        let mut alone = report();
        alone.topics.truncate(1);
        assert!(rate_corrections(&spec(), &alone, 14.9).ends_with("as `clock` a topic of 20 Hz"));
        let empty = rate_corrections(&spec(), &Report::default(), 15.0);
        assert!(empty.contains("a topic of 20 Hz"), "nothing is divided by zero: {empty}");
    }

    #[test]
    fn a_rate_near_a_whole_number_is_that_number() {
        assert_eq!([14.9, 15.2, 12.5, 0.001].map(rounded_rate), [15.0, 15.0, 12.5, 0.01]);
    }
}
