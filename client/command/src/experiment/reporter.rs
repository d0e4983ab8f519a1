//! Writes the report: at the end, and whenever another seed of a cell is settled.

use std::collections::HashSet;
use std::path::Path;

use gleaner_client::ClientError;
use serde_json::Value;

use super::gather::Gatherer;
use super::markdown::markdown;
use super::plots;
use super::report::Report;
use super::stage::Graph;
use super::standing::{Submitted, settled};
use super::state::replace;
use crate::context::Context;
use crate::failure::{Failure, Result};

/// Keeps a folder's report up to date.
pub(crate) struct Reporter<'a> {
    context: &'a Context,
    out: &'a Path,
    graph: &'a Graph,
    gatherer: Gatherer<'a>,
    /// The report without the gathered results.
    frame: Report,
    reported: HashSet<(usize, usize, usize)>,
}

impl<'a> Reporter<'a> {
    /// `frame` is the report as far as it is known from the start.
    pub(crate) fn new(
        context: &'a Context,
        out: &'a Path,
        graph: &'a Graph,
        gatherer: Gatherer<'a>,
        frame: Report,
    ) -> Self {
        Self { context, out, graph, gatherer, frame, reported: HashSet::new() }
    }

    /// Rewrites the report if another seed of a cell is settled. A failure to write does not stop the experiment.
    pub(crate) async fn more(&mut self, submitted: &Submitted) {
        let settled = settled(self.graph, submitted);
        if settled == self.reported {
            return;
        }
        self.reported = settled;
        if let Err(failure) = self.report(submitted).await {
            self.context.output.note(format_args!("the report so far can't be written: {failure}"));
        }
    }

    /// Writes the report of the results so far.
    pub(crate) async fn report(&mut self, submitted: &Submitted) -> Result<Report> {
        let studies = self.gatherer.studies(submitted).await?;
        let stages = self.gatherer.stages(submitted);
        let report = self.frame.clone().found(studies, stages);
        write(self.out, &report)?;
        Ok(report)
    }
}

/// The report as JSON.
pub(crate) fn document(report: &Report) -> Result<Value> {
    serde_json::to_value(report).map_err(|error| Failure::message(error.to_string()))
}

// The plots first, so that a report never names a missing one.
fn write(out: &Path, report: &Report) -> Result<()> {
    let mut files = Vec::new();
    for (number, study) in (1..).zip(&report.studies) {
        files.extend(plots::draw(report, number, study)?);
    }
    files.push(("report.json".to_owned(), format!("{:#}\n", document(report)?)));
    files.push(("report.md".to_owned(), markdown(report)));
    for (name, text) in files {
        let path = out.join(name);
        replace(&path, text.as_bytes()).map_err(ClientError::io(path))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt as _;

    use super::*;
    use crate::experiment::report::tests::report;

    #[test]
    fn a_report_replaces_the_previous_one_and_leaves_no_other_file() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("report.md"), "old").unwrap();
        write(folder.path(), &report()).unwrap();
        write(folder.path(), &report()).unwrap();
        assert_eq!(std::fs::read_to_string(folder.path().join("report.md")).unwrap(), markdown(&report()));
        let mut names: Vec<String> = std::fs::read_dir(folder.path())
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        assert_eq!(names, ["report.json", "report.md", "study_1.svg", "study_1_q.svg"]);
        let plain = folder.path().join("plain");
        std::fs::write(&plain, "").unwrap();
        let mode = |name: &str| std::fs::metadata(folder.path().join(name)).unwrap().permissions().mode();
        assert_eq!(mode("report.md"), mode("plain"), "others may read it as they may any file");
    }
}
