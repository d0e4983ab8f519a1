//! How much better one scorer separates good from bad than others: differences of AUROC on the same episodes.
//!
//! Must not depend on a server.

use std::fmt::Write as _;

use serde::{Deserialize, Serialize};

use super::escape::cell as escaped;
use super::study::TableKind;
use crate::quality::{Lead, mean};

/// The AUROC of q of one cell less that of another, on the same episodes, over the seeds that both have.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct AurocDifference {
    pub(crate) cell: String,
    pub(crate) less: String,
    /// Over the seeds.
    pub(crate) mean: f64,
    /// The lowest and the highest bound of the seeds' 95 % intervals; episodes are resampled for both cells at once.
    pub(crate) interval: (f64, f64),
    /// Seeds that both cells have.
    pub(crate) seeds: usize,
}

/// The score runs of a cell, by seed.
pub(super) struct Scored {
    pub(super) label: String,
    pub(super) runs: Vec<(u64, String)>,
}

/// The first cell of a study of scorers less each other; `lead` compares two runs.
pub(super) fn differences(
    table: TableKind,
    cells: &[Scored],
    mut lead: impl FnMut(&str, &str) -> Option<Lead>,
) -> Vec<AurocDifference> {
    let Some((first, others)) = cells.split_first().filter(|_| table == TableKind::Scoring) else { return Vec::new() };
    let mut found = Vec::new();
    for other in others {
        let run_of = |seed: u64| other.runs.iter().find(|run| run.0 == seed).map(|run| run.1.as_str());
        let leads: Vec<Lead> = first.runs.iter().filter_map(|(seed, run)| lead(run, run_of(*seed)?)).collect();
        let Some(mean) = mean(&leads.iter().map(|lead| lead.difference).collect::<Vec<_>>()) else { continue };
        let low = leads.iter().map(|lead| lead.low).fold(f64::INFINITY, f64::min);
        let high = leads.iter().map(|lead| lead.high).fold(f64::NEG_INFINITY, f64::max);
        let (cell, less) = (first.label.clone(), other.label.clone());
        found.push(AurocDifference { cell, less, mean, interval: (low, high), seeds: leads.len() });
    }
    found
}

/// The differences as a table in Markdown, if there are any.
pub(super) fn table(differences: &[AurocDifference]) -> Option<String> {
    let mut text = String::from("| | mean | 95 % interval | seeds |\n|---|---:|---|---:|\n");
    for AurocDifference { cell, less, mean, interval: (low, high), seeds } in differences {
        let (cell, less) = (escaped(cell), escaped(less));
        // Writing to a String cannot fail.
        let _ = writeln!(text, "| {cell} − {less} | {mean:+.3} | {low:+.3} to {high:+.3} | {seeds} |");
    }
    (!differences.is_empty()).then_some(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_scorer_is_compared_with_each_other_on_seeds_that_both_have() {
        let scored = |label: &str, runs: &[(u64, &str)]| Scored {
            label: label.to_owned(),
            runs: runs.iter().map(|(seed, run)| (*seed, (*run).to_owned())).collect(),
        };
        let cells = [
            scored("ssdf", &[(0, "a0"), (1, "a1")]),
            scored("raw", &[(0, "b0"), (1, "b1")]),
            scored("vote", &[(1, "c1"), (2, "c2")]),
            scored("none", &[]),
        ];
        let lead = |one: &str, other: &str| {
            let difference = if other.starts_with('b') { 0.125 } else { -0.25 };
            let wide = if one == "a1" { 0.0625 } else { 0.03125 };
            Some(Lead { difference, low: difference - wide, high: difference + wide })
        };
        let found = differences(TableKind::Scoring, &cells, lead);
        let text = table(&found).unwrap();
        assert!(text.ends_with(
            "| ssdf − raw | +0.125 | +0.062 to +0.188 | 2 |\n| ssdf − vote | -0.250 | -0.312 to -0.188 | 1 |\n"
        ));
        assert!(differences(TableKind::Beta, &cells, lead).is_empty() && table(&[]).is_none());
    }
}
