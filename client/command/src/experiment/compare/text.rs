//! Tables and values as text: Markdown whose columns are aligned, for terminals and files alike.

use super::super::report::PooledAuroc;
use super::report::Auroc;

/// The column of the length of an episode as if it were a score.
pub(super) const LENGTH: &str = "length alone";

/// A Markdown table whose columns have the width of their widest cell.
pub(super) fn table(header: &[String], rows: &[Vec<String>]) -> String {
    let width = |column: usize| {
        let cells = rows.iter().filter_map(|row| row.get(column)).chain(header.get(column));
        cells.map(|cell| cell.chars().count()).max().unwrap_or_default()
    };
    let widths: Vec<usize> = (0..header.len()).map(width).collect();
    let line = |cells: &[String]| {
        let cells: Vec<String> = cells.iter().zip(&widths).map(|(cell, width)| format!("{cell:width$}")).collect();
        format!("| {} |\n", cells.join(" | "))
    };
    let rule: Vec<String> = widths.iter().map(|width| "-".repeat((*width).max(3))).collect();
    let lines: Vec<String> = rows.iter().map(|row| line(row)).collect();
    format!("{}{}{}", line(header), line(&rule), lines.concat())
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
