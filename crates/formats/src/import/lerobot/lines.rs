//! Files with a JSON object on each line: all of them, or the one that has a number.
//!
//! LeRobot appends lines, so their numbers rise, and one line of many is found by bisection.

use std::cmp::Ordering;
use std::fs::File;
use std::io::{BufRead as _, BufReader, Read as _, Seek as _, SeekFrom};
use std::path::Path;

use super::tables::Cells;
use super::{info, unfit, unopened};
use crate::problem::Problem;

/// Most bytes of a line that a bisection reads.
const MOST_BYTES: u64 = 1 << 20;

/// The objects of all lines.
pub(super) fn rows(path: &Path) -> Result<Vec<Cells>, Problem> {
    let bytes = info::bytes(path)?;
    let lines = bytes.split(|&byte| byte == b'\n').enumerate().filter(|(_, line)| !line.trim_ascii().is_empty());
    let row = |(at, line): (usize, &[u8])| {
        let row = serde_json::from_slice(line);
        row.map_err(|error| unfit(path, &format!("line {}: {error}; download it again", at + 1)))
    };
    lines.map(row).collect()
}

/// The objects with a number, under this name: all of them where the numbers rise. Where the bisection meets numbers that
/// do not rise, or several lines with the number, every line is read.
pub(super) fn rows_with(path: &Path, name: &str, number: i64) -> Result<Vec<Cells>, Problem> {
    if let Some(row) = bisected(path, name, number)? {
        return Ok(vec![row]);
    }
    Ok(rows(path)?.into_iter().filter(|row| numbered(row, name) == Some(number)).collect())
}

/// The object with a number, if the numbers rise up to it and the next line has a higher one.
fn bisected(path: &Path, name: &str, number: i64) -> Result<Option<Cells>, Problem> {
    let file = File::open(path).map_err(unopened(path))?;
    let (mut low, mut high) = (0, file.metadata().map_err(Problem::io(path))?.len());
    let mut reader = BufReader::new(file);
    let mut first = None;
    // The first line with the number begins from `low` on and before `high`, or is `first`.
    while low < high {
        let middle = low.midpoint(high);
        let (begin, line) = line_from(&mut reader, middle).map_err(Problem::io(path))?;
        if begin >= high {
            high = middle;
            continue;
        }
        let Ok(row) = serde_json::from_slice::<Cells>(&line) else { return Ok(None) };
        match numbered(&row, name).map(|found| found.cmp(&number)) {
            Some(Ordering::Equal) => {
                first = Some((row, begin.saturating_add(line.len() as u64)));
                high = middle;
            }
            Some(Ordering::Less) => low = begin.saturating_add(line.len() as u64),
            Some(Ordering::Greater) => high = middle,
            None => return Ok(None),
        }
    }
    let Some((row, end)) = first else { return Ok(None) };
    let (_, next) = line_from(&mut reader, end).map_err(Problem::io(path))?;
    let higher = |next: Cells| numbered(&next, name).is_some_and(|found| found > number);
    let alone = next.is_empty() || serde_json::from_slice(&next).is_ok_and(higher);
    Ok(alone.then_some(row))
}

/// The first line that begins at a byte or after it, with its first byte.
fn line_from(reader: &mut BufReader<File>, at: u64) -> std::io::Result<(u64, Vec<u8>)> {
    // A line begins here if the byte before it ends one.
    let before = at.saturating_sub(1);
    reader.seek(SeekFrom::Start(before))?;
    let (mut begin, mut line) = (at, Vec::new());
    if at > 0 {
        begin = before + reader.by_ref().take(MOST_BYTES).read_until(b'\n', &mut line)? as u64;
        line.clear();
    }
    reader.by_ref().take(MOST_BYTES).read_until(b'\n', &mut line)?;
    Ok((begin, line))
}

fn numbered(row: &Cells, name: &str) -> Option<i64> {
    row.get(name)?.as_i64()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(numbers: impl Iterator<Item = i64>) -> tempfile::NamedTempFile {
        let file = tempfile::NamedTempFile::new().unwrap();
        let line = |number: i64| {
            format!("{{\"n\": {number}, \"text\": \"{}\"}}\n", "x".repeat(usize::try_from(number % 7).unwrap()))
        };
        std::fs::write(file.path(), numbers.map(line).collect::<String>()).unwrap();
        file
    }

    #[test]
    fn every_line_of_rising_numbers_is_bisected() {
        for count in [1, 2, 3, 100] {
            let lines = file((0..count).map(|number| number * 2));
            for number in 0..count {
                let row = bisected(lines.path(), "n", number * 2).unwrap().unwrap();
                assert_eq!(numbered(&row, "n"), Some(number * 2), "of {count}");
                assert_eq!(rows_with(lines.path(), "n", number * 2 + 1).unwrap(), [], "of {count}");
            }
            assert_eq!(rows_with(lines.path(), "n", -1).unwrap(), []);
        }
        assert_eq!(rows_with(file(0..0).path(), "n", 0).unwrap(), []);
    }

    #[test]
    fn every_line_with_a_number_is_found() {
        for count in [1, 2, 3, 50] {
            for twice in 0..count {
                for times in [2, 3, 20] {
                    let copies = |number: i64| std::iter::repeat_n(number, if number == twice { times } else { 1 });
                    let lines = file((0..count).flat_map(copies));
                    let found = |number| rows_with(lines.path(), "n", number).unwrap().len();
                    assert_eq!(found(twice), times, "{twice} of {count}");
                    for number in (0..count).filter(|number| *number != twice) {
                        assert_eq!(found(number), 1, "{number} of {count}, {twice} {times} times");
                    }
                }
            }
        }
    }

    #[test]
    fn numbers_that_do_not_rise_are_found_too() {
        let lines = file((0..100).rev());
        for number in 0..100 {
            assert_eq!(rows_with(lines.path(), "n", number).unwrap().len(), 1, "{number}");
        }
    }
}
