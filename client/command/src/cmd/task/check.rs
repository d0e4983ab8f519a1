//! `task check`: what a server would say of recordings as a task's, without a server.

use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::Args;
use gleaner_client::{BAG_METADATA, LabelledFile};
use gleaner_inspector::Assumed;
use gleaner_recording::{FindingCode, Report, Severity, TaskSpec, printable, rate_corrections};
use serde_json::{Value, json};

use super::{pace, read_spec};
use crate::alike::Alike;
use crate::cmd::label_table::LabelTableArgs;
use crate::cmd::labelled::Labels;
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
    /// CSV file with the columns file,task,outcome,cohort that labels each recording, as of a push. Default: the labels.csv
    /// in each folder given.
    #[arg(long, value_name = "CSV", requires = "recordings")]
    labels: Option<PathBuf>,
    #[command(flatten)]
    table: LabelTableArgs,
}

impl CheckArgs {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        let (_, others) = intake::split(&self.recordings);
        let labels = Labels::of(self.labels.as_deref(), &others, &self.table);
        let Checked { spec, reports, rows, labels, problems, correction } =
            checked(context, &self.spec, &self.recordings, self.rate, labels).await?;
        let text = || std::iter::once(shown(&spec, &reports)).chain(labels.clone()).collect::<Vec<_>>().join("\n");
        context.output.result(|| Ok(document(&reports, &rows)), text)?;
        if !problems.is_empty() {
            return Err(Failure::message(problems.join("; ")));
        }
        let file = words::shell_word(&self.spec.display().to_string());
        let create = if self.recordings.is_empty() {
            format!("gleaner task create {file}")
        } else {
            let paths: Vec<String> =
                self.recordings.iter().map(|path| words::shell_word(&path.display().to_string())).collect();
            let labels = self.labels.as_ref().map(|labels| {
                format!(" --labels {}{}", words::shell_word(&labels.display().to_string()), self.table.typed())
            });
            format!("gleaner push {} --task-file {file}{}", paths.join(" "), labels.unwrap_or_default())
        };
        context.output.next(correction.unwrap_or(create));
        Ok(())
    }
}

/// Checks a task file, and these recordings and labels against it; prints only what is skipped.
///
/// # Errors
/// A task file or labels that cannot be read; recordings that are rejected are among the problems.
pub(in crate::cmd) async fn checked(
    context: &Context,
    file: &Path,
    paths: &[PathBuf],
    rate_hz: Option<f64>,
    labels: Labels<'_>,
) -> Result<Checked> {
    let spec = read_spec(file)?;
    gleaner_recording::validate(&spec)?;
    let (datasets, others) = intake::split(paths);
    let labels = labels.some()?;
    if let (Some(dataset), true, true) = (datasets.first(), others.is_empty(), labels.is_some()) {
        let path = dataset.path.display();
        let problem = format!("--labels does not apply to {path}, a dataset of another program");
        return Err(Failure::message(format!("{problem}, which states its own outcomes")));
    }
    let assumed = Assumed { rate_hz, ..Assumed::default() };
    intake::expect_datasets(&datasets, &assumed)?;
    let recordings = match others.as_slice() {
        [] => Vec::new(),
        paths => intake::recordings(context, paths)?,
    };
    let labelled = labels.as_ref().map(|labels| labels.rows(Some(recordings.clone()))).transpose();
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
    let refused = reports.iter().filter(|(_, report)| report.is_err()).count();
    let rejected = (refused > 0).then(|| format!("{refused} of {} recordings would be rejected", reports.len()));
    let (rows, unlabelled) = match labelled {
        Ok(rows) => (rows.into_iter().flatten().map(|(row, _)| row).collect(), None),
        Err(error) => (Vec::new(), Some(error.to_string())),
    };
    let counted = labels.as_ref().filter(|_| !rows.is_empty()).map(|labels| labels.summary(&rows));
    let labels = counted.into_iter().flatten().map(|line| printable::field(&line).into_owned()).collect();
    let correction = pace::next(&spec, &file.display().to_string(), &accepted(&reports));
    let problems = rejected.into_iter().chain(unlabelled).collect();
    Ok(Checked { spec, reports, rows, labels, problems, correction })
}

/// What a check found.
#[derive(Debug)]
pub(in crate::cmd) struct Checked {
    pub(in crate::cmd) spec: TaskSpec,
    reports: Vec<Inspected<Report>>,
    /// The label of each recording.
    rows: Vec<LabelledFile>,
    /// Lines that count the labels.
    pub(in crate::cmd) labels: Vec<String>,
    /// Why a push of all of this would fail in part; none if it would not.
    pub(in crate::cmd) problems: Vec<String>,
    /// How to correct the task file, if its rate is that of no recording.
    pub(in crate::cmd) correction: Option<String>,
}

impl Checked {
    /// A line for each different warning and rejection.
    pub(in crate::cmd) fn findings(&self) -> Vec<String> {
        findings(&self.spec, &self.reports)
    }
}

fn accepted(reports: &[Inspected<Report>]) -> Vec<&Report> {
    reports.iter().filter_map(|(_, report)| report.as_ref().ok()).collect()
}

fn document(reports: &[Inspected<Report>], labelled: &[LabelledFile]) -> Value {
    let rows = reports.iter().map(|(path, report)| {
        let label = labelled.iter().find(|row| row.path == *path);
        let label = label.map(|row| json!({ "outcome": words::outcome(row.outcome), "cohort": row.cohort }));
        let file = path.display().to_string();
        match report {
            Ok(report) => json!({ "file": file, "report": report, "label": label }),
            Err(error) => json!({ "file": file, "error": error, "label": label }),
        }
    });
    json!({ "recordings": rows.collect::<Vec<_>>() })
}

fn shown(spec: &TaskSpec, reports: &[Inspected<Report>]) -> String {
    if reports.is_empty() {
        return format!("task {}: the specification is valid", printable::field(&spec.name));
    }
    let rows = reports.iter().map(|(path, report)| {
        let path = named(path);
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
    std::iter::once(table(columns, rows)).chain(findings(spec, reports)).collect::<Vec<_>>().join("\n")
}

/// A recording by its path; the only part of a rosbag2 folder that is named after it by that of the folder.
fn named(recording: &Path) -> String {
    let folder = recording.parent().filter(|folder| folder.join(BAG_METADATA).is_file());
    let names = |folder: &&Path| {
        let (folder, file) = (folder.file_name()?.to_str()?, recording.file_stem()?.to_str()?);
        Some(file.strip_prefix(folder)? == "_0")
    };
    folder.filter(|folder| names(folder) == Some(true)).unwrap_or(recording).display().to_string()
}

/// A line for each different warning and rejection, and one with the number of recordings that are accepted.
fn findings(spec: &TaskSpec, reports: &[Inspected<Report>]) -> Vec<String> {
    let measured = pace::measured(&accepted(reports)).unwrap_or_default();
    let (mut warnings, mut refusals) = (Alike::default(), Alike::default());
    for (path, report) in reports {
        let path = named(path);
        match report {
            Ok(report) => {
                for finding in report.findings.iter().filter(|finding| finding.severity == Severity::Warning) {
                    let text = if finding.code == FindingCode::OffRate {
                        rate_corrections(spec, report, measured)
                    } else {
                        finding.detail.clone()
                    };
                    warnings.add(&format!("{}: {text}", finding.subject), &path);
                }
            }
            Err(why) => refusals.add(why, &path),
        }
    }
    let lines = [("warning", warnings), ("rejected", refusals)].into_iter().flat_map(|(kind, alike)| alike.lines(kind));
    let total = words::counted(reports.len(), "recording", "recordings");
    let verdict = format!("accepted: {} of {total}", accepted(reports).len());
    lines.map(|line| printable::field(&line).into_owned()).chain([verdict]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spec() -> TaskSpec {
        serde_json::from_value(json!({ "name": "t", "rate_hz": 20.0, "action": [] })).unwrap()
    }

    #[test]
    fn recordings_off_the_rate_are_one_line_with_both_corrections() {
        let off = |file: &str, rate_hz| {
            let mut report = Report { mapping: "json".into(), steps: 12, rate_hz, ..Report::default() };
            report.add(Severity::Warning, FindingCode::OffRate, "clock", None, "the steps come at 14 Hz".into());
            (PathBuf::from(file), Ok(report))
        };
        let text = shown(&spec(), &[off("a.mcap", 14.4), off("b.mcap", 14.9), off("c.mcap", 15.2)]);
        let last = text.lines().rev().nth(1).unwrap();
        assert!(last.starts_with("warning: 3 recordings (a.mcap, b.mcap, c.mcap): clock: the steps of the clock come"));
        assert!(last.contains("`rate_hz = 15.0`, or in the mapping `json` as `clock` a topic of 20 Hz"), "{last}");
    }

    #[test]
    fn a_bag_is_named_by_its_folder() {
        let folder = tempfile::tempdir().unwrap();
        let bag = folder.path().join("run_7");
        let of = |name: &str| named(&bag.join(name));
        assert!(of("run_7_0.mcap").ends_with("run_7/run_7_0.mcap"), "no bag");
        std::fs::create_dir(&bag).unwrap();
        std::fs::write(bag.join(BAG_METADATA), "").unwrap();
        assert!(of("run_7_0.mcap").ends_with("/run_7"), "{}", of("run_7_0.mcap"));
        assert!(of("run_7_1.mcap").ends_with("run_7/run_7_1.mcap"), "another part");
        assert!(of("other.mcap").ends_with("run_7/other.mcap"));
    }

    #[test]
    fn refusals_alike_are_one_line() {
        let accepted = Report { mapping: "json".into(), steps: 12, ..Report::default() };
        let reports = [
            ("a.mcap".into(), Ok(accepted)),
            ("b.mcap".into(), Err("no topic /x".to_owned())),
            ("c.mcap".into(), Err("no topic /x".to_owned())),
        ];
        let spec = spec();
        let text = shown(&spec, &reports);
        assert_eq!(text.lines().count(), 6, "{text}");
        let ending = "rejected: 2 recordings (b.mcap, c.mcap): no topic /x\naccepted: 1 of 3 recordings";
        assert!(text.ends_with(ending), "{text}");
        assert_eq!(shown(&spec, &[]), "task t: the specification is valid");
    }
}
