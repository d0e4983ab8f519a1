//! Tables and values as text: Markdown whose columns are aligned, for terminals and files alike.

use super::super::escape::cell;
use super::super::report::PooledAuroc;
use super::report::Auroc;

/// A Markdown table whose columns have the width of their widest cell.
pub(super) fn table(header: &[String], rows: &[Vec<String>]) -> String {
    let escaped = |cells: &[String]| -> Vec<String> { cells.iter().map(|text| cell(text)).collect() };
    let (header, rows) = (escaped(header), rows.iter().map(|row| escaped(row)).collect::<Vec<_>>());
    let width = |column: usize| {
        let cells = rows.iter().filter_map(|row| row.get(column)).chain(header.get(column));
        cells.map(|text| text.chars().count()).max().unwrap_or_default()
    };
    let widths: Vec<usize> = (0..header.len()).map(width).collect();
    let line = |cells: &[String]| {
        let cells: Vec<String> = cells.iter().zip(&widths).map(|(text, width)| format!("{text:width$}")).collect();
        format!("| {} |\n", cells.join(" | "))
    };
    let rule: Vec<String> = widths.iter().map(|width| "-".repeat((*width).max(3))).collect();
    let lines: Vec<String> = rows.iter().map(|row| line(row)).collect();
    format!("{}{}{}", line(&header), line(&rule), lines.concat())
}

/// A value, or the reason why it is missing.
pub(super) fn value(value: Option<f64>, none: &str) -> String {
    value.map_or_else(|| none.to_owned(), |value| format!("{value:.3}"))
}

/// A share in percent, or the reason why it is missing.
pub(super) fn percent(share: Option<f64>, none: &str) -> String {
    share.map_or_else(|| none.to_owned(), |share| format!("{:.1}", share * 100.0))
}

/// An interval of shares in percent.
pub(super) fn percents((low, high): (f64, f64)) -> String {
    format!("{:.1}–{:.1}", low * 100.0, high * 100.0)
}

/// An AUROC with its interval.
pub(super) fn plain(auroc: &PooledAuroc) -> String {
    let interval = auroc.interval.map_or_else(String::new, |(low, high)| format!(" ({low:.3}–{high:.3})"));
    format!("{:.3}{interval}", auroc.mean)
}

/// An AUROC at equal length.
pub(super) fn at_equal_length(auroc: &Auroc) -> String {
    value(auroc.equal_length, "no pairs")
}

/// An AUROC at equal step.
pub(super) fn at_equal_step(auroc: &Auroc) -> String {
    value(auroc.equal_step, "no pairs")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bar_in_a_cell_is_escaped_and_columns_stay_aligned() {
        let words = |row: [&str; 2]| row.map(str::to_owned).to_vec();
        let text = table(&words(["scorer", "a|b"]), &[words(["raw", "0.5"]), words(["c|d", "1"])]);
        assert_eq!(text, "| scorer | a\\|b |\n| ------ | ---- |\n| raw    | 0.5  |\n| c\\|d   | 1    |\n");
    }
}
