//! Files of marks: from which step on recordings went right and wrong, as `gleaner record` writes them or a person noted them.
//!
//! Reads the file system; must not know a server.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use gleaner_client::ClientError;
use gleaner_sim::MARKS;
use serde::Deserialize;

use crate::failure::{Failure, Result};
use crate::quality::Mark;

/// The column that every file of marks has.
const WENT_WRONG: &str = "went_wrong";
/// The column of recordings that begin badly.
const WENT_RIGHT: &str = "went_right";

/// The cells of a row; further columns have no effect.
#[derive(Debug, Deserialize)]
struct Cells {
    episode: Option<String>,
    file: Option<String>,
    went_right: Option<String>,
    went_wrong: String,
}

/// A row of a file.
#[derive(Clone, Debug)]
pub(super) struct MarkRow {
    /// Its line in the file.
    pub(super) line: u64,
    /// The episode's id, or
    pub(super) episode: Option<String>,
    /// the name of its recording.
    pub(super) file: Option<String>,
    pub(super) mark: Mark,
}

/// The rows of a file.
///
/// # Errors
/// A file or a row that cannot be read, with its line; a missing column `went_wrong`.
pub(super) fn read(path: &Path) -> Result<Vec<MarkRow>> {
    let text = std::fs::read_to_string(path).map_err(ClientError::io(path))?;
    rows(&text).map_err(|problem| Failure::message(format!("{}: {problem}", path.display())))
}

fn rows(text: &str) -> std::result::Result<Vec<MarkRow>, String> {
    let form = "file,went_wrong or episode,went_wrong";
    let read = |(line, cells): (u64, Cells)| {
        let Cells { episode, file, went_right, went_wrong } = cells;
        let step = |column: &str, cell: &str| {
            let step = if cell.is_empty() { Ok(None) } else { cell.parse::<u32>().map(Some) };
            step.map_err(|_| format!("line {line}: {column}: expected a step or an empty cell, got {cell:?}"))
        };
        let went_right = step(WENT_RIGHT, &went_right.unwrap_or_default())?;
        let went_wrong = step(WENT_WRONG, &went_wrong)?;
        Ok(MarkRow { line, episode, file, mark: Mark { went_right, went_wrong } })
    };
    gleaner_client::rows::<Cells>(text, &[WENT_WRONG], form)?.into_iter().map(read).collect()
}

/// The marks of a folder of recordings, each of one recording.
#[derive(Debug)]
pub(super) struct FolderMarks {
    folder: PathBuf,
    by_file: HashMap<String, Mark>,
}

impl FolderMarks {
    /// # Errors
    /// A file that cannot be read, a row without a file, and a file that is listed twice.
    pub(super) fn read(folder: &Path) -> Result<Self> {
        let path = folder.join(MARKS);
        let mut by_file = HashMap::new();
        for MarkRow { line, file, mark, .. } in read(&path)? {
            let wrong = |problem: String| Failure::message(format!("{}: line {line}: {problem}", path.display()));
            let file = file.ok_or_else(|| wrong("has no file; fill this column".into()))?;
            if by_file.insert(file.clone(), mark).is_some() {
                return Err(wrong(format!("{file} is listed twice; keep one line")));
            }
        }
        Ok(Self { folder: folder.to_owned(), by_file })
    }

    /// Takes the mark of a recording: of its path within the folder, or else of its name. A row is taken once, so that two
    /// recordings of one name in different folders never share a mark.
    ///
    /// # Errors
    /// A recording without a row of its own.
    pub(super) fn take(&mut self, recording: &Path) -> Result<Mark> {
        let within = recording.strip_prefix(&self.folder).unwrap_or(recording).to_string_lossy();
        let name = recording.file_name().unwrap_or_default().to_string_lossy();
        let mark = self.by_file.remove(within.as_ref()).or_else(|| self.by_file.remove(name.as_ref()));
        mark.ok_or_else(|| {
            let marks = self.folder.join(MARKS);
            Failure::message(format!("{within} has no row of its own in {}; add one", marks.display()))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder(marks: &str) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join(MARKS), marks).unwrap();
        folder
    }

    #[test]
    fn a_row_has_its_line_behind_blank_lines_and_cells_of_several_lines() {
        let text = "file,went_wrong,note\n\na.mcap,3,\"slow\nand late\"\n\n\nb.mcap,,x\n";
        for begin in ["", "\u{feff}"] {
            let found: Vec<_> = rows(&format!("{begin}{text}"))
                .unwrap()
                .into_iter()
                .map(|row| (row.line, row.file.unwrap(), row.mark.went_wrong))
                .collect();
            assert_eq!(found, [(3, "a.mcap".to_owned(), Some(3)), (7, "b.mcap".to_owned(), None)]);
        }
        let windows = rows("file,went_wrong\r\n\r\na.mcap,3\r\n\r\nb.mcap,late\r\n").unwrap_err();
        assert_eq!(windows, "line 5: went_wrong: expected a step or an empty cell, got \"late\"");
        assert!(rows("file,went_wrong\n\n\na.mcap\n").unwrap_err().starts_with("line 4: has 1 cells"));
        let early = rows("file,went_right,went_wrong\na.mcap,early,3\n").unwrap_err();
        assert_eq!(early, "line 2: went_right: expected a step or an empty cell, got \"early\"");
    }

    #[test]
    fn segments_of_a_false_start_are_bad() {
        let rows = rows("file,went_right,went_wrong\na.mcap,2,4\nb.mcap,,\nc.mcap,2,\n").unwrap();
        let bad = |row: usize| (0..6).map(|step| rows[row].mark.is_bad(step)).collect::<Vec<_>>();
        assert_eq!(bad(0), [true, true, false, false, true, true]);
        assert_eq!(bad(1), [false; 6]);
        assert_eq!(bad(2), [true, true, false, false, false, false]);
    }

    #[test]
    fn marks_are_read_with_their_gaps() {
        let text = "file,agent,grade,seed,success,went_wrong,departure\n\
                    a.mcap,expert,0,0,true,,\nb.mcap,noise,1,1,false,3,0 0.5 2\n";
        let folder = folder(text);
        let mut marks = FolderMarks::read(folder.path()).unwrap();
        let mut of = |name: &str| marks.take(&folder.path().join(name)).unwrap().went_wrong;
        assert_eq!((of("a.mcap"), of("b.mcap")), (None, Some(3)));
    }

    #[test]
    fn a_file_without_the_column_or_with_a_recording_twice_is_rejected() {
        let problem = |text: &str| FolderMarks::read(folder(text).path()).unwrap_err().to_string();
        for (text, part) in [
            ("file,wrong\na.mcap,3\n", "column \"went_wrong\" is missing"),
            ("file,went_wrong\na.mcap,3\n\na.mcap,4\n", "line 4: a.mcap is listed twice"),
            ("episode,went_wrong\nep_1,3\n", "line 2: has no file"),
        ] {
            let problem = problem(text);
            assert!(problem.contains(part) && problem.contains(MARKS), "{problem}");
        }
    }

    #[test]
    fn recordings_of_one_name_have_marks_of_their_own() {
        let folder = folder("file,went_wrong\none/a.mcap,1\ntwo/a.mcap,2\nb.mcap,3\n");
        let mut marks = FolderMarks::read(folder.path()).unwrap();
        let mut of = |name: &str| marks.take(&folder.path().join(name));
        assert_eq!(of("two/a.mcap").unwrap().went_wrong, Some(2));
        assert_eq!(of("one/a.mcap").unwrap().went_wrong, Some(1));
        assert_eq!(of("one/b.mcap").unwrap().went_wrong, Some(3));
        let problem = of("two/b.mcap").unwrap_err().to_string();
        assert!(problem.contains("two/b.mcap has no row of its own"), "{problem}");
    }
}
