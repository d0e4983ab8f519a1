//! The texts of a dataset's tasks, by their numbers.

use std::collections::BTreeMap;
use std::path::Path;

use serde_json::Value;

use super::info::{self, Info};
use super::tables::read_table;
use super::unfit;
use crate::problem::Problem;

/// Names of the column with the text: pandas writes an index without a name as the second.
const TEXTS: [&str; 2] = ["task", "__index_level_0__"];
const NUMBER: &str = "task_index";
/// Longest instruction in bytes.
const LONGEST: usize = 1000;

pub(super) fn read(folder: &Path, info: &Info) -> Result<BTreeMap<i64, String>, Problem> {
    let rows = if info.shares_files() {
        let columns: Vec<String> = TEXTS.iter().chain([&NUMBER]).map(|name| (*name).to_owned()).collect();
        read_table(&folder.join("meta/tasks.parquet"), &columns)?
    } else {
        let path = folder.join("meta/tasks.jsonl");
        let bytes = info::bytes(&path)?;
        let lines = bytes.split(|&byte| byte == b'\n').filter(|line| !line.trim_ascii().is_empty());
        let read: Result<Vec<_>, _> = lines.map(serde_json::from_slice).collect();
        read.map_err(|error| unfit(&path, &format!("{error}; download it again")))?
    };
    let task = |row: &BTreeMap<String, Value>| {
        let text = TEXTS.iter().find_map(|name| row.get(*name)?.as_str())?;
        Some((row.get(NUMBER)?.as_i64()?, text.to_owned()))
    };
    Ok(rows.iter().filter_map(task).collect())
}

/// The text that all episodes have, if it can be the instruction of a task.
pub(super) fn only(tasks: &BTreeMap<i64, String>) -> Option<&str> {
    let mut texts = tasks.values();
    let first = texts.next().filter(|first| !first.is_empty() && first.len() <= LONGEST)?;
    let plain = !first.chars().any(char::is_control);
    (plain && texts.all(|text| text == first)).then_some(first)
}
