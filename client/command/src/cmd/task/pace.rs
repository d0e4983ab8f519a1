//! Recordings whose steps are off the task's rate: the two corrections of the task file.
//!
//! Works on reports alone.

use gleaner_recording::{FindingCode, Report, TaskSpec};

use crate::draft::rounded;

/// Rates this near to that of the task, as a share of it, are its rate.
const NEAR: f64 = 0.2;
/// Most topics that a correction names.
const NAMED: usize = 3;

/// Whether a recording's steps are off the rate.
pub(super) fn is_off(report: &Report) -> bool {
    report.findings.iter().any(|finding| finding.code == FindingCode::OffRate)
}

/// The rate of the recordings that are off the task's, as a task file has it: the median; `None` if none is off.
pub(super) fn measured(reports: &[&Report]) -> Option<f64> {
    let mut rates: Vec<f64> = reports.iter().filter(|report| is_off(report)).map(|report| report.rate_hz).collect();
    rates.sort_by(f64::total_cmp);
    rates.get(rates.len() / 2).copied().map(rounded)
}

/// Both corrections: the measured rate, or a clock that has the task's rate, with the topics that have it.
pub(super) fn corrections(spec: &TaskSpec, report: &Report, measured: f64) -> String {
    let mapping = spec.mappings.iter().find(|mapping| mapping.name == report.mapping);
    let clock = mapping.and_then(|mapping| mapping.clock_topic(spec));
    let topics = topics_of_rate(spec, report, clock);
    let such = if topics.is_empty() { String::new() } else { format!(", such as {}", topics.join(" or ")) };
    format!(
        "the steps of {} come at {:.1} Hz and the task has {} Hz: set `rate_hz = {measured:?}`, or in the mapping `{}` as \
         `clock` a topic of {} Hz{such}",
        clock.unwrap_or("the clock"),
        report.rate_hz,
        spec.rate_hz,
        report.mapping,
        spec.rate_hz
    )
}

/// What to do after a check in which every recording is off the rate; `None` if one is not.
pub(super) fn next(spec: &TaskSpec, file: &str, reports: &[&Report]) -> Option<String> {
    let rate = measured(reports).filter(|_| reports.iter().all(|report| is_off(report)))?;
    let other = format!("another `clock` whose topic has {} Hz", spec.rate_hz);
    Some(format!("correct {file}: `rate_hz = {rate:?}`, or {other}; then check it again"))
}

/// The topics of the mapping that come about as often as the task's rate, with their rates.
#[expect(clippy::cast_precision_loss, reason = "a rate for people")]
fn topics_of_rate(spec: &TaskSpec, report: &Report, clock: Option<&str>) -> Vec<String> {
    let seconds = report.duration_ns as f64 / 1e9;
    let used = report.topics.iter().filter(|topic| topic.used && Some(topic.topic.as_str()) != clock);
    let rated = used.map(|topic| (topic.topic.as_str(), topic.messages.saturating_sub(1) as f64 / seconds));
    let near = rated.filter(|(_, rate)| seconds > 0.0 && (rate / spec.rate_hz - 1.0).abs() <= NEAR);
    near.take(NAMED).map(|(topic, rate)| format!("{topic} (about {rate:.0} Hz)")).collect()
}

#[cfg(test)]
mod tests {
    use gleaner_recording::{Severity, TopicReport};

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

    /// A recording of ten seconds whose steps come at this rate.
    fn report(rate_hz: f64, off: bool) -> Report {
        let mut report = Report { mapping: "json".into(), rate_hz, duration_ns: 10_000_000_000, ..Report::default() };
        report.topics = [("/cmd", 149, true), ("/front", 201, true), ("/joints", 501, true), ("/rosout", 201, false)]
            .map(|(topic, messages, used)| TopicReport {
                topic: topic.into(),
                schema: String::new(),
                encoding: "json".into(),
                messages,
                used,
            })
            .into();
        if off {
            report.add(Severity::Warning, FindingCode::OffRate, "clock", None, "steps come every 67.1 ms".into());
        }
        report
    }

    #[test]
    fn both_corrections_are_named_with_the_measured_rate_and_the_topics_of_the_tasks_rate() {
        assert_eq!(
            corrections(&spec(), &report(14.9, true), 15.0),
            "the steps of /cmd come at 14.9 Hz and the task has 20 Hz: set `rate_hz = 15.0`, or in the mapping `json` as \
             `clock` a topic of 20 Hz, such as /front (about 20 Hz)"
        );
        let mut alone = report(14.9, true);
        alone.topics.truncate(1);
        assert!(corrections(&spec(), &alone, 15.0).ends_with("as `clock` a topic of 20 Hz"));
        assert!(
            corrections(&spec(), &Report::default(), 15.0).contains("a topic of 20 Hz"),
            "nothing is divided by zero"
        );
    }

    #[test]
    fn the_next_step_is_the_correction_where_every_recording_is_off() {
        let (off, slower, good) = (report(14.9, true), report(12.0, true), report(20.0, false));
        let next = |reports: &[&Report]| next(&spec(), "task.toml", reports);
        let correction = next(&[&off, &slower, &off]).unwrap();
        let expected =
            "correct task.toml: `rate_hz = 15.0`, or another `clock` whose topic has 20 Hz; then check it again";
        assert_eq!(correction, expected);
        assert_eq!((next(&[&off, &good]), next(&[])), (None, None));
    }
}
