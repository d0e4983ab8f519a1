//! `task check`: what a server would say of recordings as a task's, without a server.

use std::path::PathBuf;
use std::time::Duration;

use clap::Args;
use gleaner_inspector::Assumed;
use gleaner_recording::{Report, Severity, printable};
use serde_json::{Value, json};

use super::read_spec;
use crate::alike::Alike;
use crate::context::Context;
use crate::failure::{Failure, Result};
use crate::inspector::{Inspected, Inspector};
use crate::intake::{self, Intake, Opened};
use crate::table::Column::{Left, Right};
use crate::table::table;
use crate::words;

#[derive(Args, Debug)]
pub(crate) struct CheckArgs {
    /// File with the specification, TOML or JSON.
    spec: PathBuf,
    /// Recordings, or folders that are searched for *.mcap, or datasets of other programs. Without one the specification
    /// alone is checked.
    recordings: Vec<PathBuf>,
    /// Steps per second of a dataset of another program that does not state them. Default: 20.
    #[arg(long, value_name = "HZ")]
    rate: Option<f64>,
}

impl CheckArgs {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        let spec = read_spec(&self.spec)?;
        gleaner_recording::validate(&spec)?;
        let (datasets, others) = intake::split(&self.recordings);
        let assumed = Assumed { rate_hz: self.rate, ..Assumed::default() };
        intake::expect_datasets(&datasets, &assumed)?;
        let recordings = match others.as_slice() {
            [] => Vec::new(),
            paths => intake::recordings(context, paths)?,
        };
        let inspector = Inspector::find()?;
        let mut reports = inspector.check(&recordings, &spec).await?;
        let Opened { intakes, skipped, refused } = Intake::open_all(context, &datasets, &assumed).await?;
        intake::note(context, &skipped);
        reports.extend(refused.into_iter().map(|(path, why)| (path, Err(why))));
        for intake in intakes {
            for run in intake.runs() {
                let mut walk = intake.walk(run);
                while let Some((number, made)) = walk.next().await? {
                    let report = match made {
                        Ok(episode) => inspector.check(std::slice::from_ref(&episode.recording), &spec).await?.pop(),
                        Err(why) => Some((PathBuf::new(), Err(why))),
                    };
                    reports.extend(report.map(|(_, report)| (intake.place(number), report)));
                }
            }
        }
        context.output.result(|| Ok(document(&reports)), || shown(&spec.name, &reports))?;
        let refused = reports.iter().filter(|(_, report)| report.is_err()).count();
        if refused > 0 {
            return Err(Failure::message(format!("{refused} of {} recordings would be rejected", reports.len())));
        }
        context.output.next(format_args!("gleaner task create {}", self.spec.display()));
        Ok(())
    }
}

fn document(reports: &[Inspected<Report>]) -> Value {
    let rows = reports.iter().map(|(path, report)| {
        let file = path.display().to_string();
        match report {
            Ok(report) => json!({ "file": file, "report": report }),
            Err(error) => json!({ "file": file, "error": error }),
        }
    });
    json!({ "recordings": rows.collect::<Vec<_>>() })
}

fn shown(task: &str, reports: &[Inspected<Report>]) -> String {
    if reports.is_empty() {
        return format!("task {}: the specification is valid", printable::field(task));
    }
    let rows = reports.iter().map(|(path, report)| {
        let path = path.display().to_string();
        match report {
            Ok(report) => {
                let warnings = report.findings.iter().filter(|finding| finding.severity == Severity::Warning).count();
                let duration = Duration::from_nanos(u64::try_from(report.duration_ns).unwrap_or_default());
                [
                    path,
                    report.mapping.clone(),
                    report.steps.to_string(),
                    words::duration(duration),
                    format!("{:.1} Hz", report.rate_hz),
                    warnings.to_string(),
                    "accepted".to_owned(),
                ]
            }
            Err(_) => {
                let none = || "-".to_owned();
                [path, none(), none(), none(), none(), none(), "rejected".to_owned()]
            }
        }
    });
    let columns = [
        Left("RECORDING"),
        Left("MAPPING"),
        Right("STEPS"),
        Right("DURATION"),
        Right("RATE"),
        Right("WARNINGS"),
        Left("RESULT"),
    ];
    let mut text = table(columns, rows);
    let (mut warnings, mut refusals) = (Alike::default(), Alike::default());
    for (path, report) in reports {
        let path = path.display().to_string();
        match report {
            Ok(report) => {
                for finding in report.findings.iter().filter(|finding| finding.severity == Severity::Warning) {
                    warnings.add(&format!("{}: {}", finding.subject, finding.detail), &path);
                }
            }
            Err(why) => refusals.add(why, &path),
        }
    }
    for (kind, alike) in [("warning", warnings), ("rejected", refusals)] {
        for line in alike.lines(kind) {
            text.push('\n');
            text += &printable::field(&line);
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn refusals_alike_are_one_line() {
        let accepted = Report { mapping: "json".into(), steps: 12, ..Report::default() };
        let reports = [
            ("a.mcap".into(), Ok(accepted)),
            ("b.mcap".into(), Err("no topic /x".to_owned())),
            ("c.mcap".into(), Err("no topic /x".to_owned())),
        ];
        let text = shown("t", &reports);
        assert_eq!(text.lines().count(), 5, "{text}");
        assert!(text.ends_with("rejected: 2 recordings (b.mcap, c.mcap): no topic /x"), "{text}");
        assert_eq!(shown("t", &[]), "task t: the specification is valid");
    }
}
