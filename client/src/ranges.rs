//! Times of the episodes in a long recording, from a CSV file.
//!
//! Reads the file system; must not know a server.

use std::collections::BTreeSet;
use std::path::Path;

use gleaner_proto::v1::Outcome;
use gleaner_recording::TimeRange;
use serde::Deserialize;

use crate::error::{ClientError, Result};
use crate::labels::outcome_from_word;
use crate::rows::rows;

/// One row of a file of ranges: `start,end,success,name`. Other columns are ignored.
#[derive(Clone, Debug, PartialEq)]
pub struct NamedRange {
    /// Its time and outcome.
    pub range: TimeRange,
    /// A name for its episode; empty if the file has none.
    pub name: String,
}

#[derive(Deserialize)]
struct Row {
    start: f64,
    end: f64,
    success: Option<String>,
    name: Option<String>,
}

/// Reads a file of ranges, in the order of their start. Whether they fit each other and a recording is not checked.
///
/// # Errors
/// [`ClientError::Io`] when it can't be read; [`ClientError::Invalid`] names the line that is wrong, a missing column, or a
/// name that is given twice.
pub fn read_ranges(csv_path: &Path) -> Result<Vec<NamedRange>> {
    let text = std::fs::read_to_string(csv_path).map_err(ClientError::io(csv_path))?;
    let wrong = |problem: String| ClientError::Invalid(format!("{}: {problem}", csv_path.display()));
    let form = "start,end,success,name (success and name may be left out)";
    let mut names = BTreeSet::new();
    let mut ranges = Vec::new();
    for (line, row) in rows(&text, &["start", "end"], form).map_err(wrong)? {
        let Row { start, end, success, name } = row;
        let at_line = |problem: String| wrong(format!("line {line}: {problem}"));
        let name = name.unwrap_or_default();
        if let Some(odd) = name.chars().find(|c| !c.is_ascii_alphanumeric() && !"_-.".contains(*c)) {
            return Err(at_line(format!("the name {name:?} has {odd:?}; use letters, digits, `_`, `-` and `.`")));
        }
        if !name.is_empty() && !names.insert(name.clone()) {
            return Err(at_line(format!("the name {name} is given twice; change one")));
        }
        let success = outcome(&success.unwrap_or_default()).map_err(at_line)?;
        ranges.push(NamedRange { range: TimeRange { start_s: start, end_s: end, success }, name });
    }
    if ranges.is_empty() {
        return Err(wrong("it has no ranges; add a line for each episode".to_owned()));
    }
    ranges.sort_by(|one, other| one.range.start_s.total_cmp(&other.range.start_s));
    Ok(ranges)
}

/// The outcome that a cell states: a flag, or the word for one.
fn outcome(cell: &str) -> std::result::Result<Option<bool>, String> {
    Ok(match cell.to_ascii_lowercase().as_str() {
        "true" | "1" => Some(true),
        "false" | "0" => Some(false),
        "" => None,
        word => match outcome_from_word(word) {
            Ok(Outcome::Success) => Some(true),
            Ok(Outcome::Failure) => Some(false),
            Ok(Outcome::Unknown | Outcome::Unspecified) => None,
            Err(_) => {
                return Err(format!("success {cell:?}: unknown value; supported: true, false, unknown, or nothing"));
            }
        },
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Vec<NamedRange>> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("ranges.csv");
        std::fs::write(&path, text).unwrap();
        read_ranges(&path)
    }

    #[test]
    fn rows_become_ranges_in_the_order_of_time() {
        let range = |start_s, end_s, success, name: &str| NamedRange {
            range: TimeRange { start_s, end_s, success },
            name: name.to_owned(),
        };
        let found = read("start,end,success,name\n12.5,20,failure,late\n0, 3.25, true,\n4,5,,mid.1\n").unwrap();
        let expected =
            [range(0.0, 3.25, Some(true), ""), range(4.0, 5.0, None, "mid.1"), range(12.5, 20.0, Some(false), "late")];
        assert_eq!(found, expected);
        assert_eq!(read("end,start\n2,1\n").unwrap(), [range(1.0, 2.0, None, "")]);
    }

    #[test]
    fn a_wrong_line_is_named() {
        for (text, part) in [
            ("start,stop\n1,2\n", "column \"end\" is missing"),
            ("start,end\n", "it has no ranges"),
            ("start,end\n1,late\n", "line 2: end: invalid float"),
            ("start,end,success\n\n1,2,true\n\n3,4,maybe\n", "line 5: success \"maybe\""),
            ("start,end,success\n1,2,true\n3,4,maybe\n", "line 3: success \"maybe\""),
            ("start,end,name\n1,2,../x\n", "line 2: the name \"../x\" has '/'"),
            ("start,end,name\n1,2,a\n3,4,a\n", "line 3: the name a is given twice"),
        ] {
            let message = read(text).unwrap_err().to_string();
            assert!(message.contains(part) && message.contains("ranges.csv"), "{message}");
        }
    }
}
