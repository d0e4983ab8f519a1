//! Labels files of recordings: which ones are meant, and the row of each recording. Must not know a server.

mod listed;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use gleaner_client::{LABELS_FILE, LabelledFile};
use gleaner_proto::v1::Outcome;

use super::label_table::LabelTableArgs;
use crate::failure::{Failure, Result};
use crate::words;

/// Fewest experts of a score run: each is compared with the others.
const FEWEST_EXPERTS: usize = 2;

/// The labels files of a command, and how their tables are read.
#[derive(Debug)]
pub(super) struct Labels<'a> {
    files: Vec<PathBuf>,
    searched: bool,
    table: &'a LabelTableArgs,
}

impl<'a> Labels<'a> {
    /// The file that was named, or those in the folders among `paths`.
    pub(super) fn of(named: Option<&Path>, paths: &[PathBuf], table: &'a LabelTableArgs) -> Self {
        let files = match named {
            Some(file) => vec![file.to_owned()],
            None => paths.iter().map(|path| path.join(LABELS_FILE)).filter(|labels| labels.is_file()).collect(),
        };
        Self { files, searched: named.is_none(), table }
    }

    /// No file, where labels come from elsewhere.
    pub(super) fn none(table: &'a LabelTableArgs) -> Self {
        Self { files: Vec::new(), searched: false, table }
    }

    /// These, or `None` if there is no file.
    ///
    /// # Errors
    /// An option of a table that was given without one.
    pub(super) fn some(self) -> Result<Option<Self>> {
        if self.files.is_empty() {
            self.table.refuse("--labels")?;
        }
        Ok(Some(self).filter(|labels| !labels.files.is_empty()))
    }

    /// The names of files that no option named; `None` if one did.
    pub(super) fn found(&self) -> Option<String> {
        self.searched.then(|| self.named())
    }

    fn named(&self) -> String {
        self.files.iter().map(|file| file.display().to_string()).collect::<Vec<_>>().join(", ")
    }

    /// The row of each of these recordings, or every row, with its file.
    ///
    /// # Errors
    /// As [`LabelTableArgs::read`]; a recording without a row; a row that several recordings may be; no row at all.
    pub(super) fn rows(&self, recordings: Option<Vec<PathBuf>>) -> Result<Vec<(LabelledFile, &Path)>> {
        let mut rows = Vec::new();
        for file in &self.files {
            rows.extend(self.table.read(file)?.into_iter().map(|row| (row, file.as_path())));
        }
        if let Some(recordings) = recordings {
            rows = listed::chosen(rows, recordings, &self.files, self.searched)?;
        }
        if rows.is_empty() {
            return Err(Failure::message(format!("{} lists no recordings", self.named())));
        }
        Ok(rows)
    }

    /// How many of these rows have each label, with a warning where no score run could be made of them.
    pub(super) fn summary(&self, rows: &[LabelledFile]) -> Vec<String> {
        let of = |outcome: Outcome| rows.iter().filter(move |row| row.outcome == outcome);
        let mut cohorts: BTreeMap<&str, usize> = BTreeMap::new();
        for row in of(Outcome::Failure) {
            *cohorts.entry(&row.cohort).or_default() += 1;
        }
        let cohorts: Vec<String> =
            cohorts
                .iter()
                .map(|(cohort, count)| {
                    if cohort.is_empty() {
                        format!("{count} without a cohort")
                    } else {
                        format!("{count} \"{cohort}\"")
                    }
                })
                .collect();
        let [successes, failures, unknown] =
            [Outcome::Success, Outcome::Failure, Outcome::Unknown].map(|outcome| of(outcome).count());
        let mut line = format!(
            "labels of {}: {}, {}",
            self.named(),
            words::counted(successes, "success", "successes"),
            words::counted(failures, "failure", "failures")
        );
        if !cohorts.is_empty() {
            line += &format!(" ({})", cohorts.join(", "));
        }
        if unknown > 0 {
            line += &format!(", {unknown} unknown");
        }
        let mut lines = vec![line];
        if successes < FEWEST_EXPERTS || failures == 0 {
            lines.push("warning: scores need at least two successes, as experts, and a failure".to_owned());
        }
        lines
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(outcome: Outcome, cohort: &str) -> LabelledFile {
        let path = PathBuf::from("a.mcap");
        LabelledFile { listed: path.clone(), path, line: 2, task: None, outcome, cohort: cohort.into() }
    }

    #[test]
    fn labels_are_counted_and_too_few_are_a_warning() {
        let table = LabelTableArgs::default();
        let labels = Labels::of(Some(Path::new("trials.csv")), &[], &table);
        let rows = [
            row(Outcome::Success, ""),
            row(Outcome::Success, "morning"),
            row(Outcome::Failure, "dropped"),
            row(Outcome::Failure, ""),
            row(Outcome::Failure, "dropped"),
            row(Outcome::Unknown, ""),
        ];
        let line = "labels of trials.csv: 2 successes, 3 failures (1 without a cohort, 2 \"dropped\"), 1 unknown";
        assert_eq!(labels.summary(&rows), [line]);
        assert_eq!(labels.summary(&rows[..2])[0], "labels of trials.csv: 2 successes, 0 failures");
        for few in [&rows[..2], &rows[1..4]] {
            let warning = "warning: scores need at least two successes, as experts, and a failure";
            assert_eq!(labels.summary(few)[1..], [warning]);
        }
    }

    #[test]
    fn files_in_folders_are_found_unless_one_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let paths = [folder.path().to_owned()];
        let table = LabelTableArgs::default();
        assert!(Labels::of(None, &paths, &table).some().unwrap().is_none());
        let file = folder.path().join(LABELS_FILE);
        std::fs::write(&file, "file,outcome\na.mcap,success\n").unwrap();
        let found = Labels::of(None, &paths, &table).some().unwrap().unwrap();
        assert_eq!((found.files.clone(), found.found()), (vec![file.clone()], Some(file.display().to_string())));
        assert_eq!(found.rows(None).unwrap()[0].0.outcome, Outcome::Success);
        let problem = found.rows(Some(vec![folder.path().join("b.mcap")])).unwrap_err().to_string();
        assert!(problem.contains("b.mcap is not listed in "), "{problem}");
        assert_eq!(Labels::of(Some(&file), &paths, &table).found(), None);
    }
}
