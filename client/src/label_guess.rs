//! Which columns of a lab's own table are labels: a guess from its header and its words.
//!
//! Reads the file system; must not know a server.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::path::{Path, PathBuf};

use crate::labels::LABELS_FILE;
use crate::rows::rows;

/// A table beside recordings that may have their labels.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TableGuess {
    /// The table.
    pub table: PathBuf,
    /// The column that names recordings.
    pub file: String,
    /// The column of the outcome.
    pub outcome: String,
    /// The column of the kind of a failure, if there is one.
    pub cohort: Option<String>,
    /// The words of the outcome; one or several are of a success.
    pub words: Vec<String>,
    /// That of a success, if the column of the kind of a failure is empty in its rows and in no other.
    pub success: Option<String>,
}

/// Parts of the header of an outcome, the likeliest first.
const OUTCOMES: [&str; 8] = ["outcome", "success", "verdict", "result", "ended", "status", "label", "ok"];
/// Parts of the header of a kind of failure, the likeliest first.
const COHORTS: [&str; 12] = [
    "cohort", "kind", "trouble", "fault", "failure", "mishap", "cause", "problem", "reason", "defect", "error",
    "remark",
];
/// Cells of a kind of failure that name none.
const NO_KIND: [&str; 5] = ["", "-", "none", "n/a", "no"];
/// Most words of an outcome.
const WORDS: usize = 4;

/// The only table in `folder` at least half of whose rows name recordings of these names; `None` without such a table, or
/// with several. A labels.csv is found without a guess.
#[must_use]
pub fn guess_table(folder: &Path, names: &BTreeSet<String>) -> Option<TableGuess> {
    let mut found: Vec<TableGuess> = Vec::new();
    for entry in std::fs::read_dir(folder).ok()?.flatten() {
        let path = entry.path();
        let is_table = path.extension().is_some_and(|extension| extension == "csv" || extension == "tsv");
        if is_table && path.is_file() && !path.ends_with(LABELS_FILE) {
            let text = std::fs::read_to_string(&path).unwrap_or_default();
            found.extend(of_text(&text, names).map(|guess| TableGuess { table: path, ..guess }));
        }
    }
    if found.len() == 1 { found.pop() } else { None }
}

fn of_text(text: &str, names: &BTreeSet<String>) -> Option<TableGuess> {
    let rows: Vec<HashMap<String, String>> = rows(text, &[], "").ok()?.into_iter().map(|(_, row)| row).collect();
    let headers: BTreeSet<&String> = rows.first()?.keys().filter(|header| !header.contains([',', '='])).collect();
    let named = |header: &str| cells(&rows, header).filter(|cell| names.contains(stem(cell))).count();
    let file = *headers.iter().max_by_key(|header| named(header)).filter(|header| named(header) * 2 >= rows.len())?;
    let words: BTreeMap<&String, BTreeSet<&String>> = headers
        .iter()
        .filter(|header| **header != file)
        .map(|header| (*header, cells(&rows, header).collect()))
        .collect();
    let like = |parts: &[&str], fits: &dyn Fn(&String) -> bool| {
        let header = |part: &&str| {
            words.keys().copied().find(|header| header.to_lowercase().contains(*part) && fits(header)).cloned()
        };
        parts.iter().find_map(header)
    };
    let outcome = like(&OUTCOMES, &|header| (2..=WORDS).contains(&words[header].len()))?;
    // All rows of one outcome have no kind, and all others one of few.
    let success = |header: &String| {
        let kind = |row: &HashMap<String, String>| {
            row.get(header).filter(|cell| !NO_KIND.contains(&cell.trim().to_lowercase().as_str())).cloned()
        };
        let (failed, others): (Vec<_>, Vec<_>) = rows.iter().partition(|row| kind(row).is_some());
        let outcomes = |rows: &[&HashMap<String, String>]| -> BTreeSet<String> {
            rows.iter().filter_map(|row| row.get(&outcome).cloned()).collect()
        };
        let kinds: BTreeSet<String> = failed.iter().filter_map(|row| kind(row)).collect();
        let (of_failed, of_others) = (outcomes(&failed), outcomes(&others));
        let apart = of_others.len() == 1 && of_others.is_disjoint(&of_failed) && kinds.len() * 2 <= failed.len();
        of_others.into_iter().next().filter(|_| apart && !failed.is_empty())
    };
    let telling = |header: &String| *header != outcome && success(header).is_some();
    let by_cells = || words.keys().copied().find(|header| telling(header)).cloned();
    let by_name = like(&COHORTS, &telling).or_else(by_cells);
    let cohort = by_name.or_else(|| like(&COHORTS, &|header| *header != outcome));
    let success = cohort.as_ref().and_then(success);
    let words = words[&outcome].iter().map(|word| (*word).clone()).collect();
    Some(TableGuess { table: PathBuf::new(), file: file.clone(), outcome, cohort, words, success })
}

/// The cells of a column that are not empty.
fn cells<'a>(rows: &'a [HashMap<String, String>], header: &str) -> impl Iterator<Item = &'a String> {
    let cells: Vec<&String> = rows.iter().filter_map(|row| row.get(header)).filter(|cell| !cell.is_empty()).collect();
    cells.into_iter()
}

/// A cell without the folders and the ending of a recording.
fn stem(cell: &str) -> &str {
    let name = cell.rsplit(['/', '\\']).next().unwrap_or(cell);
    name.strip_suffix(".mcap").unwrap_or(name)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(names: &[&str]) -> BTreeSet<String> {
        names.iter().map(|name| (*name).to_owned()).collect()
    }

    #[test]
    fn columns_are_found_by_their_headers_and_words() {
        let text = "Bag;Date;Operator;Verdict;Trouble;Remark\na;1;mk;binned;folded;late\nb.mcap;1;ela;served;-;\nday/c;2;mk;served;-;x\n";
        let found = of_text(text, &names(&["a", "b", "c"])).unwrap();
        assert_eq!((found.file.as_str(), found.outcome.as_str()), ("Bag", "Verdict"));
        assert_eq!((found.cohort.as_deref(), found.words), (Some("Trouble"), vec!["binned".into(), "served".into()]));
        let other = of_text("run,how_it_ended\na,watered\nb,dry\n", &names(&["a", "b"])).unwrap();
        assert_eq!((other.outcome.as_str(), other.cohort), ("how_it_ended", None));
    }

    #[test]
    fn the_word_of_a_success_is_that_of_the_rows_without_a_kind_of_failure() {
        let rows = "a;cured;;x\nb;spoilt;slid off;see video\nc;spoilt;slid off;\nd;cured;-;slow\n";
        let of = |header: &str, rows: &str| of_text(&format!("{header}{rows}"), &names(&["a", "b", "c", "d"])).unwrap();
        let found = of("bag;verdict;mishap;remark\n", rows);
        assert_eq!((found.cohort.as_deref(), found.success.as_deref()), (Some("mishap"), Some("cured")));
        // Whatever the column is called.
        let found = of("bag;verdict;what;remark\n", rows);
        assert_eq!((found.cohort.as_deref(), found.success.as_deref()), (Some("what"), Some("cured")));
        // A success with a kind, and a failure without one.
        for other in [rows.replace("d;cured;-", "d;cured;slid off"), rows.replace("c;spoilt;slid off", "c;spoilt;")] {
            let found = of("bag;verdict;mishap;remark\n", &other);
            assert_eq!((found.cohort.as_deref(), found.success), (Some("mishap"), None), "{other}");
        }
    }

    #[test]
    fn a_table_of_other_things_is_no_guess() {
        for text in
            ["run,verdict\nx,good\ny,bad\n", "run,speed\na,1\nb,2\n", "run,verdict\na,good\nb,good\n", "", "run\n"]
        {
            assert_eq!(of_text(text, &names(&["a", "b"])), None, "{text}");
        }
    }

    #[test]
    fn one_table_in_a_folder_is_a_guess_and_two_are_none() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str| std::fs::write(folder.path().join(name), "run\tresult\na\tok\nb\tno\n").unwrap();
        let guess = || guess_table(folder.path(), &names(&["a", "b"]));
        write("labels.csv");
        assert_eq!(guess(), None);
        write("trials.tsv");
        assert_eq!(guess().unwrap().table, folder.path().join("trials.tsv"));
        write("more.csv");
        assert_eq!(guess(), None);
        assert_eq!(guess_table(&folder.path().join("none"), &names(&["a"])), None);
    }
}
