//! The texts of a dataset's tasks, by their numbers.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::path::Path;

use super::info::Info;
use super::lines;
use super::tables::{Cells, Table};
use crate::problem::Problem;

/// Names of the column with the text: pandas writes an index without a name as the second.
const TEXTS: [&str; 2] = ["task", "__index_level_0__"];
const NUMBER: &str = "task_index";
/// The table of tasks, and its name before v3.0.
const TABLE: &str = "meta/tasks.parquet";
const LINES: &str = "meta/tasks.jsonl";
/// Longest instruction in bytes.
const LONGEST: usize = 1000;

/// The texts of all tasks.
pub(super) fn read(folder: &Path, info: &Info) -> Result<BTreeMap<i64, String>, Problem> {
    let rows = if info.shares_files() {
        Table::open(&folder.join(TABLE))?.rows(&columns(), None)?
    } else {
        lines::rows(&folder.join(LINES))?
    };
    Ok(rows.iter().filter_map(task).collect())
}

/// The texts of the tasks of some episodes, each looked up once.
#[derive(Default)]
pub(super) struct Texts {
    known: BTreeMap<i64, Option<String>>,
    table: Option<Table>,
}

impl Texts {
    /// The text of a task, if it has one.
    pub(super) fn of(&mut self, folder: &Path, info: &Info, number: i64) -> Result<Option<&str>, Problem> {
        let text = match self.known.entry(number) {
            Entry::Occupied(known) => known.into_mut(),
            Entry::Vacant(unknown) => {
                let rows = if info.shares_files() {
                    let table = match self.table.take() {
                        Some(table) => table,
                        None => Table::open(&folder.join(TABLE))?,
                    };
                    self.table.insert(table).rows(&columns(), Some((NUMBER, &(number..=number))))?
                } else {
                    lines::rows_with(&folder.join(LINES), NUMBER, number)?
                };
                unknown.insert(rows.iter().filter_map(task).next_back().map(|(_, text)| text))
            }
        };
        Ok(text.as_deref())
    }
}

fn columns() -> Vec<String> {
    TEXTS.iter().chain([&NUMBER]).map(|name| (*name).to_owned()).collect()
}

fn task(row: &Cells) -> Option<(i64, String)> {
    let text = TEXTS.iter().find_map(|name| row.get(*name)?.as_str())?;
    Some((row.get(NUMBER)?.as_i64()?, text.to_owned()))
}

/// The text that all episodes have, if it can be the instruction of a task.
pub(super) fn only(tasks: &BTreeMap<i64, String>) -> Option<&str> {
    let mut texts = tasks.values();
    let first = texts.next().filter(|first| !first.is_empty() && first.len() <= LONGEST)?;
    let plain = !first.chars().any(char::is_control);
    (plain && texts.all(|text| text == first)).then_some(first)
}
