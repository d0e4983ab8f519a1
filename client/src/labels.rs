//! Labels of recordings, from a labels.csv or a table of a lab's own.
//!
//! Reads the file system; must not know a server.

use std::collections::{BTreeSet, HashMap};
use std::path::{Path, PathBuf};

use gleaner_proto::v1::Outcome;

use crate::error::{ClientError, Result};
use crate::rows::rows;

/// The name of a labels file, by which it is found in a folder.
pub const LABELS_FILE: &str = "labels.csv";

/// One row of a labels.csv: `file,task,outcome,cohort`. Other columns are ignored.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LabelledFile {
    /// The recording; relative paths in the file are relative to the file's folder.
    pub path: PathBuf,
    /// The recording as the file lists it.
    pub listed: PathBuf,
    /// Its line in the file.
    pub line: u64,
    /// Its task, if the file has the column.
    pub task: Option<String>,
    /// How the attempt ended.
    pub outcome: Outcome,
    /// Its cohort; empty if the file lacks the column.
    pub cohort: String,
}

/// Where a table has what labels.csv has. The default is labels.csv.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LabelTable {
    /// The table's column for each column of labels.csv that has another name there.
    columns: Vec<(LabelColumn, String)>,
    /// The words of a success. Every other word is then a failure, and an empty cell an unknown outcome. Empty: success,
    /// failure and unknown.
    successes: Vec<String>,
}

/// A column of labels.csv.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum LabelColumn {
    File,
    Task,
    Outcome,
    Cohort,
}

impl LabelColumn {
    const ALL: [Self; 4] = [Self::File, Self::Task, Self::Outcome, Self::Cohort];

    fn name(self) -> &'static str {
        match self {
            Self::File => "file",
            Self::Task => "task",
            Self::Outcome => "outcome",
            Self::Cohort => "cohort",
        }
    }
}

impl LabelTable {
    /// From pairs such as `file=recording`, and the words of a success.
    ///
    /// # Errors
    /// A pair of another form, an unknown column of labels.csv, or one that is given twice.
    pub fn new(pairs: &[String], successes: Vec<String>) -> std::result::Result<Self, String> {
        let mut columns: Vec<(LabelColumn, String)> = Vec::new();
        for pair in pairs {
            let form = || format!("{pair:?} is not file=COLUMN, task=COLUMN, outcome=COLUMN or cohort=COLUMN");
            let (own, theirs) = pair.split_once('=').ok_or_else(form)?;
            let (own, theirs) = (own.trim(), theirs.trim());
            let column = LabelColumn::ALL.into_iter().find(|column| column.name() == own).ok_or_else(form)?;
            if theirs.is_empty() {
                return Err(form());
            }
            if columns.iter().any(|(given, _)| *given == column) {
                return Err(format!("{own} is given twice; keep one"));
            }
            columns.push((column, theirs.to_owned()));
        }
        Ok(Self { columns, successes })
    }

    fn named(&self, column: LabelColumn) -> Option<&str> {
        self.columns.iter().find(|(given, _)| *given == column).map(|(_, name)| name.as_str())
    }

    fn name(&self, column: LabelColumn) -> &str {
        self.named(column).unwrap_or(column.name())
    }

    fn cell<'a>(&self, row: &'a HashMap<String, String>, column: LabelColumn) -> &'a str {
        row.get(self.name(column)).map_or("", String::as_str)
    }

    fn outcome(&self, word: &str) -> std::result::Result<Outcome, String> {
        if self.successes.is_empty() {
            return outcome_from_word(word);
        }
        let lower = word.to_lowercase();
        let is = |known: &str| known.trim().to_lowercase() == lower;
        Ok(match word {
            _ if self.successes.iter().any(|success| is(success)) => Outcome::Success,
            "" => Outcome::Unknown,
            _ => Outcome::Failure,
        })
    }

    /// The words of the outcome, where none of them is a success.
    fn without_success(&self, rows: &[(u64, HashMap<String, String>)]) -> Option<String> {
        let words: BTreeSet<&str> = rows.iter().map(|(_, row)| self.cell(row, LabelColumn::Outcome)).collect();
        let any = |word: &&str| self.outcome(word) == Ok(Outcome::Success);
        if self.successes.is_empty() || words.is_empty() || words.iter().any(any) {
            return None;
        }
        let words: Vec<String> = words.into_iter().take(10).map(|word| format!("{word:?}")).collect();
        let column = self.name(LabelColumn::Outcome);
        Some(format!("column {column:?} has no {:?}, but {}", self.successes.join(" or "), words.join(", ")))
    }
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

/// Reads a labels.csv.
///
/// # Errors
/// As [`read_table`].
pub fn read_labels(csv_path: &Path) -> Result<Vec<LabelledFile>> {
    read_table(csv_path, &LabelTable::default())
}

/// Reads a labels.csv, or a table that has its columns under other names. The recordings need not exist.
///
/// # Errors
/// [`ClientError::Io`] when it can't be read; [`ClientError::Invalid`] names the line that is wrong, a missing
/// column, a word of a success that no line has, or a recording that is listed twice.
pub fn read_table(csv_path: &Path, table: &LabelTable) -> Result<Vec<LabelledFile>> {
    let text = std::fs::read_to_string(csv_path).map_err(ClientError::io(csv_path))?;
    let folder = csv_path.parent().unwrap_or_else(|| Path::new(""));
    let wrong = |problem: String| ClientError::Invalid(format!("{}: {problem}", csv_path.display()));
    let form = "file,task,outcome,cohort (task and cohort may be left out)";
    let mut needed = vec![table.name(LabelColumn::File), table.name(LabelColumn::Outcome)];
    needed.extend([LabelColumn::Task, LabelColumn::Cohort].into_iter().filter_map(|column| table.named(column)));
    let rows = rows::<HashMap<String, String>>(&text, &needed, form).map_err(wrong)?;
    if let Some(problem) = table.without_success(&rows) {
        return Err(wrong(problem));
    }
    let mut seen = BTreeSet::new();
    let mut files = Vec::new();
    for (line, row) in rows {
        let at_line = |problem: String| wrong(format!("line {line}: {problem}"));
        let cell = |column| table.cell(&row, column);
        let file = cell(LabelColumn::File);
        if file.is_empty() {
            return Err(at_line(format!("the {} is empty", table.name(LabelColumn::File))));
        }
        if !seen.insert(file.to_owned()) {
            return Err(at_line(format!("{file} is listed twice; keep one line")));
        }
        files.push(LabelledFile {
            path: folder.join(file),
            listed: file.into(),
            line,
            task: Some(cell(LabelColumn::Task).to_owned()).filter(|task| !task.is_empty()),
            outcome: table.outcome(cell(LabelColumn::Outcome)).map_err(at_line)?,
            cohort: cell(LabelColumn::Cohort).to_owned(),
        });
    }
    Ok(files)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Vec<LabelledFile>> {
        read_as(text, &LabelTable::default())
    }

    fn read_as(text: &str, table: &LabelTable) -> Result<Vec<LabelledFile>> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("labels.csv");
        std::fs::write(&path, text).unwrap();
        let mut files = read_table(&path, table)?;
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
            listed: "a.mcap".into(),
            line: 2,
            task: Some("PickCube-v0".into()),
            outcome: Outcome::Success,
            cohort: "expert".into(),
        };
        let b = LabelledFile {
            path: "sub/b.mcap".into(),
            listed: "sub/b.mcap".into(),
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

    const OWN: &str = "run;who;result;trouble\nr1;Pekka;Stamped;\nr2;Jonna;no good;dropped, twice\nr3;Jonna;;\n";

    fn table(pairs: &[&str], successes: &[&str]) -> std::result::Result<LabelTable, String> {
        let pairs: Vec<String> = pairs.iter().map(|&pair| pair.to_owned()).collect();
        LabelTable::new(&pairs, successes.iter().map(|&word| word.to_owned()).collect())
    }

    #[test]
    fn a_table_of_a_labs_own_is_read_by_its_columns_and_words() {
        let own = table(&["file=run", "outcome=result", "cohort = trouble"], &["stamped"]).unwrap();
        for text in [OWN.to_owned(), OWN.replace(';', "\t")] {
            let found = read_as(&text, &own).unwrap();
            let found: Vec<_> =
                found.iter().map(|row| (row.listed.to_str().unwrap(), row.outcome, row.cohort.as_str())).collect();
            let (success, failure) = (Outcome::Success, Outcome::Failure);
            assert_eq!(found, [("r1", success, ""), ("r2", failure, "dropped, twice"), ("r3", Outcome::Unknown, "")]);
        }
    }

    #[test]
    fn the_case_of_a_success_does_not_matter_in_any_alphabet() {
        let own = table(&[], &["ÄLYKÄS"]).unwrap();
        let found = read_as("file,outcome\na.mcap,älykäs\nb.mcap,alykas\n", &own).unwrap();
        let outcomes: Vec<Outcome> = found.iter().map(|row| row.outcome).collect();
        assert_eq!(outcomes, [Outcome::Success, Outcome::Failure]);
    }

    #[test]
    fn a_table_that_does_not_fit_is_refused_with_what_it_has() {
        let refused = |pairs: &[&str], successes: &[&str]| {
            read_as(OWN, &table(pairs, successes).unwrap()).unwrap_err().to_string()
        };
        let columns = &["file=run", "outcome=result"];
        for (message, part) in [
            (refused(&[], &[]), "column \"file\" is missing among run, who, result, trouble; the first line must be"),
            (refused(&["file=run", "outcome=end"], &[]), "column \"end\" is missing among run"),
            (refused(&["file=run", "outcome=result", "cohort=kind"], &["Stamped"]), "column \"kind\" is missing"),
            (refused(columns, &[]), "line 2: outcome \"Stamped\": unknown value"),
            (refused(columns, &["inked"]), "column \"result\" has no \"inked\", but \"\", \"Stamped\", \"no good\""),
        ] {
            assert!(message.contains(part), "{message}");
        }
        for (pairs, part) in [
            (&["run"][..], "\"run\" is not file=COLUMN"),
            (&["name=run"], "is not file=COLUMN"),
            (&["file="], "is not file=COLUMN"),
            (&["file=a", "file=b"], "file is given twice"),
        ] {
            assert!(table(pairs, &[]).unwrap_err().contains(part), "{pairs:?}");
        }
    }
}
