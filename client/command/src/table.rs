//! Tables for people: a header line, then rows; plain when piped.

use comfy_table::presets::NOTHING;
use comfy_table::{CellAlignment, ColumnConstraint, ContentArrangement, Table};
use gleaner_recording::printable;

/// Characters of an id behind its prefix.
const ULID: usize = 26;

/// A column's header and which side its cells lean to.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Column {
    Left(&'static str),
    Right(&'static str),
}

impl Column {
    fn header(self) -> &'static str {
        match self {
            Self::Left(header) | Self::Right(header) => header,
        }
    }
}

/// Rows under headers, two spaces apart. Wraps to the terminal's width when there is one, but keeps the ids of the first
/// column whole, which people copy.
pub(crate) fn table<const N: usize>(columns: [Column; N], rows: impl IntoIterator<Item = [String; N]>) -> String {
    arranged(Table::new(), columns, rows)
}

fn arranged<const N: usize>(
    mut table: Table,
    columns: [Column; N],
    rows: impl IntoIterator<Item = [String; N]>,
) -> String {
    table.load_style(NOTHING).set_content_arrangement(ContentArrangement::Dynamic);
    table.set_header(columns.map(Column::header));
    // Here rather than at the end, so that columns have the width of what is shown and no cell breaks its row.
    let rows = rows.into_iter().map(|cells| cells.map(|cell| printable::field(&cell).into_owned()));
    let rows: Vec<[String; N]> = rows.collect();
    let first = || rows.iter().filter_map(|row| row.first());
    let ids = first().next().filter(|cell| is_id(cell)).and_then(|_| first().map(|cell| cell.chars().count()).max());
    table.add_rows(rows);
    for (index, column) in columns.iter().enumerate() {
        if let Some(drawn) = table.column_mut(index) {
            drawn.set_padding((0, 2));
            if matches!(column, Column::Right(_)) {
                drawn.set_cell_alignment(CellAlignment::Right);
            }
        }
    }
    if let (Some(ids), Some(width)) = (ids, table.width())
        && ids <= usize::from(width / 2)
        && let Some(first) = table.column_mut(0)
    {
        first.set_constraint(ColumnConstraint::ContentWidth);
    }
    table.trim_fmt()
}

/// Whether a cell is the id of something: a prefix and a ULID.
fn is_id(cell: &str) -> bool {
    let ulid = cell.split_once('_').map(|(_, ulid)| ulid);
    ulid.is_some_and(|ulid| ulid.len() == ULID && ulid.bytes().all(|byte| byte.is_ascii_alphanumeric()))
}

/// `name  value` lines, the values in one column.
pub(crate) fn facts<const N: usize>(pairs: [(&str, String); N]) -> String {
    let width = pairs.iter().map(|(name, _)| name.chars().count()).max().unwrap_or(0);
    pairs.map(|(name, value)| format!("{name:width$}  {}\n", printable::field(&value))).concat()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_aligned_to_their_side() {
        let drawn = table(
            [Column::Left("id"), Column::Right("steps")],
            [["ep_1".into(), "7".into()], ["ep_20".into(), "1204".into()]],
        );
        assert_eq!(drawn, "id     steps\nep_1       7\nep_20   1204");
    }

    #[test]
    fn cells_and_facts_stay_on_one_line_with_escapes_visible() {
        let hostile = "\u{1b}[2J\u{202e}a\nep_2  9";
        let shown = "\\u{1b}[2J\\u{202e}a\\nep_2  9";
        let drawn = table([Column::Left("name"), Column::Right("n")], [[hostile.into(), "1".into()]]);
        assert_eq!(drawn.lines().nth(1).and_then(|line| line.strip_suffix("  1")), Some(shown), "{drawn}");
        assert_eq!(facts([("name", hostile.into())]), format!("name  {shown}\n"));
    }

    #[test]
    fn an_id_is_whole_in_a_narrow_terminal() {
        let id = "ep_01ARZ3NDEKTSV4RRFFQ69G5FAV";
        let drawn = |width, first: &str| {
            let mut table = Table::new();
            table.set_width(width);
            let columns = [Column::Left("ID"), Column::Right("STEPS"), Column::Left("FILE")];
            let file = "a recording with a name of many words that does not fit.mcap";
            arranged(table, columns, [[first.to_owned(), "26".into(), file.into()]])
        };
        assert!(drawn(70, id).contains(&format!("\n{id}  ")), "{}", drawn(70, id));
        // Neither the id of a terminal without room for more, nor another text.
        assert!(!drawn(30, id).contains(id));
        let text = "words ".repeat(20);
        assert!(drawn(70, &text).lines().all(|line| line.chars().count() <= 70), "{}", drawn(70, &text));
    }

    #[test]
    fn facts_are_aligned() {
        assert_eq!(facts([("id", "a".into()), ("steps", "7".into())]), "id     a\nsteps  7\n");
    }
}
