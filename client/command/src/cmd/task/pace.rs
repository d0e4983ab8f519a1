//! Recordings whose steps are off the task's rate: their rate, and the corrections of the task file.
//!
//! Works on reports alone.

use gleaner_recording::{FindingCode, Report, TaskSpec, rounded_rate};

/// Whether a recording's steps are off the rate.
pub(super) fn is_off(report: &Report) -> bool {
    report.findings.iter().any(|finding| finding.code == FindingCode::OffRate)
}

/// The rate of the recordings that are off the task's: the median; `None` if every recording has the task's.
pub(super) fn measured(reports: &[&Report]) -> Option<f64> {
    let mut rates: Vec<f64> = reports.iter().filter(|report| is_off(report)).map(|report| report.rate_hz).collect();
    rates.sort_by(f64::total_cmp);
    rates.get(rates.len() / 2).copied()
}

/// What to do after a check in which every recording is off the rate; `None` if one is not.
pub(super) fn next(spec: &TaskSpec, file: &str, reports: &[&Report]) -> Option<String> {
    let rate = measured(reports).filter(|_| reports.iter().all(|report| is_off(report)))?;
    let other = format!("another `clock` whose topic has {} Hz", spec.rate_hz);
    Some(format!("correct {file}: `rate_hz = {:?}`, or {other}; then check it again", rounded_rate(rate)))
}

#[cfg(test)]
mod tests {
    use gleaner_recording::Severity;
    use serde_json::json;

    use super::*;

    /// A recording whose steps come at this rate.
    fn report(rate_hz: f64, off: bool) -> Report {
        let mut report = Report { rate_hz, ..Report::default() };
        if off {
            report.add(Severity::Warning, FindingCode::OffRate, "clock", None, "the steps come at 14.9 Hz".into());
        }
        report
    }

    #[test]
    fn the_next_step_is_the_correction_where_every_recording_is_off() {
        let spec: TaskSpec = serde_json::from_value(json!({ "name": "t", "rate_hz": 20.0, "action": [] })).unwrap();
        let (off, slower, good) = (report(14.9, true), report(12.0, true), report(20.0, false));
        let next = |reports: &[&Report]| next(&spec, "task.toml", reports);
        let correction = next(&[&off, &slower, &off]).unwrap();
        let expected =
            "correct task.toml: `rate_hz = 15.0`, or another `clock` whose topic has 20 Hz; then check it again";
        assert_eq!(correction, expected);
        assert_eq!((next(&[&off, &good]), next(&[])), (None, None));
    }
}
