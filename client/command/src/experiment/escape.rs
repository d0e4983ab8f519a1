//! Texts within the Markdown of a report. Depends on no other module.

/// A text within a cell of a table: neither a `|` ends the cell nor a line break the row.
pub(super) fn cell(text: &str) -> String {
    text.replace('|', "\\|").split_whitespace().collect::<Vec<_>>().join(" ")
}
