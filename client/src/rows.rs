//! Rows of a CSV file, each with its line.
//!
//! Pure code.

use serde::de::DeserializeOwned;

/// The rows of a CSV file below its header, each with the line at which it begins. Other columns have no effect. Cells are
/// between commas, semicolons or tabs.
///
/// # Errors
/// A column of `needed` that is missing, with the header `form`; a row that cannot be read, with its line.
pub fn rows<T: DeserializeOwned>(text: &str, needed: &[&str], form: &str) -> Result<Vec<(u64, T)>, String> {
    let headers = header(text, needed, form)?;
    let text = plain(text);
    let mut reader = reader(text);
    let mut place = Place { text: text.as_bytes(), byte: 0, line: 1 };
    let mut rows = Vec::new();
    for record in reader.records() {
        let at = match &record {
            Ok(record) => record.position(),
            Err(error) => error.position(),
        };
        let line = place.line_of(at.map_or(0, csv::Position::byte));
        let row = record.and_then(|record| record.deserialize(Some(&headers)));
        rows.push((line, row.map_err(|error| format!("line {line}: {}", problem(&error, &headers)))?));
    }
    Ok(rows)
}

/// The columns of a CSV file.
///
/// # Errors
/// As [`rows`].
fn header(text: &str, needed: &[&str], form: &str) -> Result<csv::StringRecord, String> {
    let headers = reader(plain(text)).headers().map_err(|error| error.to_string())?.clone();
    for needed in needed {
        if !headers.iter().any(|header| header == *needed) {
            let there: Vec<&str> = headers.iter().collect();
            let there = there.join(", ");
            return Err(format!("column {needed:?} is missing among {there}; the first line must be {form}"));
        }
    }
    Ok(headers)
}

/// The text without the mark that spreadsheets write at its begin.
fn plain(text: &str) -> &str {
    text.strip_prefix('\u{feff}').unwrap_or(text)
}

/// Reads cells between commas, or between what the first line has more of: semicolons or tabs.
fn reader(text: &str) -> csv::Reader<&[u8]> {
    let first = text.trim_start().lines().next().unwrap_or_default();
    let count = |delimiter: &u8| first.bytes().filter(|byte| byte == delimiter).count();
    // The last of equals.
    let delimiter = [b'\t', b';', b','].into_iter().max_by_key(count).unwrap_or(b',');
    csv::ReaderBuilder::new().delimiter(delimiter).trim(csv::Trim::All).from_reader(text.as_bytes())
}

fn problem(error: &csv::Error, headers: &csv::StringRecord) -> String {
    if let csv::ErrorKind::Deserialize { err, .. } = error.kind() {
        let column = err.field().and_then(|field| headers.get(usize::try_from(field).ok()?));
        return format!("{}: {}", column.unwrap_or("a cell"), err.kind());
    }
    if let csv::ErrorKind::UnequalLengths { expected_len, len, .. } = error.kind() {
        return format!(
            "has {len} cells, and the first line {expected_len}; add the missing ones, or put a cell with commas into quotes"
        );
    }
    error.to_string()
}

/// A place in a text, and its line.
struct Place<'a> {
    text: &'a [u8],
    byte: usize,
    line: u64,
}

impl Place<'_> {
    /// The line of the record that the reader has found from this byte on: it skips blank lines before a record, and counts
    /// them as a part of it.
    fn line_of(&mut self, byte: u64) -> u64 {
        let from = usize::try_from(byte).unwrap_or(usize::MAX);
        while let Some(next) = self.text.get(self.byte) {
            if self.byte >= from && !matches!(next, b'\n' | b'\r') {
                break;
            }
            self.line += u64::from(*next == b'\n');
            self.byte += 1;
        }
        self.line
    }
}

#[cfg(test)]
mod tests {
    use serde::Deserialize;

    use super::*;

    #[derive(Debug, Deserialize, PartialEq)]
    struct Row {
        a: String,
        b: u32,
    }

    fn read(text: &str) -> Result<Vec<(u64, String, u32)>, String> {
        let read = rows::<Row>(text, &["a", "b"], "a,b")?;
        Ok(read.into_iter().map(|(line, Row { a, b })| (line, a, b)).collect())
    }

    #[test]
    fn a_row_has_its_line_behind_blank_lines_and_cells_of_several_lines() {
        let expected = [(3, "x".to_owned(), 1), (6, "y\nz".to_owned(), 2), (8, "w".to_owned(), 3)];
        let text = "a,b\n\nx,1\n\n\n\"y\nz\",2\nw,3";
        for begin in ["", "\u{feff}"] {
            assert_eq!(read(&format!("{begin}{text}")).unwrap(), expected);
            let unbroken = text.replace("y\nz", "yz").replace('\n', "\r\n");
            let lines: Vec<u64> =
                read(&format!("{begin}{unbroken}")).unwrap().into_iter().map(|(line, ..)| line).collect();
            assert_eq!(lines, [3, 6, 7]);
        }
    }

    #[test]
    fn a_wrong_row_is_named_by_its_line() {
        for (text, part) in [
            ("b,c\n1,2\n", "column \"a\" is missing among b, c; the first line must be a,b"),
            ("a,b\n\n\nx,1\n\ny,z\n", "line 6: b: invalid digit"),
            ("a,b\n\nx\n", "line 3: has 1 cells, and the first line 2"),
        ] {
            let problem = read(text).unwrap_err();
            assert!(problem.contains(part), "{problem}");
        }
    }
}
