//! Labels of recordings, from a labels.csv.
//!
//! Reads the file system; must not know a server.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use gleaner_proto::v1::Outcome;
use serde::Deserialize;

use crate::error::{ClientError, Result};
use crate::rows::rows;

/// One row of a labels.csv: `file,task,outcome,cohort`. Other columns are ignored.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LabelledFile {
    /// The recording; relative paths in the file are relative to the file's folder.
    pub path: PathBuf,
    /// Its line in the file.
    pub line: u64,
    /// Its task, if the file has the column.
    pub task: Option<String>,
    /// How the attempt ended.
    pub outcome: Outcome,
    /// Its cohort; empty if the file lacks the column.
    pub cohort: String,
}

#[derive(Deserialize)]
struct Row {
    file: String,
    task: Option<String>,
    outcome: String,
    cohort: Option<String>,
}

/// The word for an outcome: `success`, `failure` or `unknown`.
///
/// # Errors
/// Another word; the message lists the three.
pub fn outcome_from_word(word: &str) -> std::result::Result<Outcome, String> {
    match word.trim().to_ascii_lowercase().as_str() {
        "success" => Ok(Outcome::Success),
        "failure" => Ok(Outcome::Failure),
        "unknown" => Ok(Outcome::Unknown),
        _ => Err(format!("outcome {word:?}: unknown value; supported: success, failure, unknown")),
    }
}

/// Reads a labels.csv. The recordings need not exist.
///
/// # Errors
/// [`ClientError::Io`] when it can't be read; [`ClientError::Invalid`] names the line that is wrong, a missing
/// column, or a recording that is listed twice.
pub fn read_labels(csv_path: &Path) -> Result<Vec<LabelledFile>> {
    let text = std::fs::read_to_string(csv_path).map_err(ClientError::io(csv_path))?;
    let folder = csv_path.parent().unwrap_or_else(|| Path::new(""));
    let wrong = |problem: String| ClientError::Invalid(format!("{}: {problem}", csv_path.display()));
    let form = "file,task,outcome,cohort (task and cohort may be left out)";
    let mut seen = BTreeSet::new();
    let mut files = Vec::new();
    for (line, row) in rows::<Row>(&text, &["file", "outcome"], form).map_err(wrong)? {
        let at_line = |problem: String| wrong(format!("line {line}: {problem}"));
        if row.file.is_empty() {
            return Err(at_line("the file is empty".into()));
        }
        if !seen.insert(row.file.clone()) {
            return Err(at_line(format!("{} is listed twice; keep one line", row.file)));
        }
        files.push(LabelledFile {
            path: folder.join(&row.file),
            line,
            task: row.task.filter(|task| !task.is_empty()),
            outcome: outcome_from_word(&row.outcome).map_err(at_line)?,
            cohort: row.cohort.unwrap_or_default(),
        });
    }
    Ok(files)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Vec<LabelledFile>> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("labels.csv");
        std::fs::write(&path, text).unwrap();
        let mut files = read_labels(&path)?;
        for file in &mut files {
            file.path = file.path.strip_prefix(folder.path()).unwrap().to_owned();
        }
        Ok(files)
    }

    #[test]
    fn rows_become_labels_relative_to_the_csv() {
        let files = read("file,task,outcome,cohort\na.mcap,PickCube-v0,success,expert\nsub/b.mcap,,failure,noise3\n");
        let a = LabelledFile {
            path: "a.mcap".into(),
            line: 2,
            task: Some("PickCube-v0".into()),
            outcome: Outcome::Success,
            cohort: "expert".into(),
        };
        let b = LabelledFile {
            path: "sub/b.mcap".into(),
            line: 3,
            task: None,
            outcome: Outcome::Failure,
            cohort: "noise3".into(),
        };
        assert_eq!(files.unwrap(), [a, b]);
    }

    #[test]
    fn columns_may_be_in_any_order_missing_or_extra() {
        let files = read("outcome, note, file\nUnknown, x, a.mcap\n").unwrap();
        assert_eq!((files[0].outcome, files[0].cohort.as_str()), (Outcome::Unknown, ""));
    }

    #[test]
    fn a_wrong_line_is_named() {
        for (text, part) in [
            ("file,outcome\na.mcap,success\nb.mcap,maybe\n", "line 3: outcome \"maybe\""),
            ("file,outcome\na.mcap,success\na.mcap,failure\n", "line 3: a.mcap is listed twice"),
            ("file,cohort\na.mcap,x\n", "column \"outcome\" is missing"),
            ("file,outcome\n,success\n", "line 2: the file is empty"),
            ("file,outcome\na.mcap\n", "line 2: has 1 cells"),
            ("file,outcome\n\na.mcap,success\n\nb.mcap,maybe\n", "line 5: outcome \"maybe\""),
        ] {
            let message = read(text).unwrap_err().to_string();
            assert!(message.contains(part) && message.contains("labels.csv"), "{message}");
        }
    }
}
