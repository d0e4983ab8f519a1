//! How much better one method is than another: the difference of their success, seed by seed.
//!
//! The same seed means the same recordings, the same encoder where both have one, and the same evaluation attempts,
//! so the difference of a pair scatters less than either rate.

use gleaner_core::statistics::difference_over_levels;

use super::cell::CellSettings;
use super::escape::cell as escaped;
use super::interval::student;
use super::method::Method;
use super::rate::{RESAMPLING_SEED, Rate};
use super::report::{CellReport, Difference, SeedDifference};
use super::study::TableKind;
use crate::quality::mean;

/// A difference whose interval cannot be given.
const GAP: &str = "-";

/// The pairs that show the effect of one part of the method: first the method with it, then the one without.
const PAIRS: [(Method, Method); 5] = [
    (Method::SSDF, Method::SSDF_BASE),
    (Method::SSDF, Method::TF_BC),
    (Method::SSDF, Method::BC),
    (Method::SSDF_BASE, Method::TF_BC),
    (Method::SSDF_ACT, Method::ACT),
];

/// The differences that a study's table shows: in a table of methods, between those that have all other settings in common;
/// in any other comparison of cells, of each cell with the first.
pub(crate) fn differences(table: TableKind, cells: &[CellReport]) -> Vec<Difference> {
    match table {
        TableKind::Methods => of_methods(cells),
        TableKind::Cells => {
            let pairs = cells
                .split_first()
                .into_iter()
                .flat_map(|(first, others)| others.iter().map(move |cell| (cell, first)));
            pairs.filter_map(|(cell, first)| difference(cell, first)).collect()
        }
        TableKind::Objectives | TableKind::Beta | TableKind::Similarity | TableKind::Quantity | TableKind::Scoring => {
            Vec::new()
        }
    }
}

fn of_methods(cells: &[CellReport]) -> Vec<Difference> {
    let mut found = Vec::new();
    for (method, less) in PAIRS {
        for cell in cells.iter().filter(|cell| cell.settings.method == method) {
            let alike = CellSettings { method: less, ..cell.settings.clone() };
            let other = cells.iter().find(|other| other.settings == alike);
            found.extend(other.and_then(|other| difference(cell, other)));
        }
    }
    found
}

fn difference(cell: &CellReport, less: &CellReport) -> Option<Difference> {
    let of_seed = |seed: u64| less.seeds.iter().find(|other| other.seed == seed)?.success;
    let paired = cell.seeds.iter().filter_map(|seed| Some((seed.seed, seed.success?, of_seed(seed.seed)?)));
    let paired: Vec<(u64, Rate, Rate)> = paired.collect();
    let of_pair = |&(seed, rate, less): &(u64, Rate, Rate)| SeedDifference { seed, difference: rate.rate - less.rate };
    let seeds: Vec<SeedDifference> = paired.iter().map(of_pair).collect();
    let values: Vec<f64> = seeds.iter().map(|seed| seed.difference).collect();
    let attempts: Vec<_> = paired.iter().map(|(_, rate, less)| (rate.attempts(), less.attempts())).collect();
    Some(Difference {
        cell: cell.label.clone(),
        less: less.label.clone(),
        mean: mean(&values)?,
        interval: student(&values).map(|(low, high)| (low.max(-1.0), high.min(1.0))),
        interval_of_levels: difference_over_levels(&attempts, RESAMPLING_SEED),
        seeds,
    })
}

/// The differences as a table in Markdown, if there are any.
pub(crate) fn table(differences: &[Difference]) -> Option<String> {
    let mut text = String::from(
        "| | mean, % points | 95 % t-interval over seeds | 95 % bootstrap over seeds and attempts | seed by seed |\n\
         |---|---:|---:|---:|---|\n",
    );
    for pair in differences {
        let points = |share: f64| format!("{:+.1}", share * 100.0);
        let interval = |of: Option<(f64, f64)>| {
            of.map_or_else(|| GAP.to_owned(), |(low, high)| format!("{} to {}", points(low), points(high)))
        };
        let seeds: Vec<String> =
            pair.seeds.iter().map(|seed| format!("{}: {}", seed.seed, points(seed.difference))).collect();
        text.push_str(&format!(
            "| {} − {} | {} | {} | {} | {} |\n",
            escaped(&pair.cell),
            escaped(&pair.less),
            points(pair.mean),
            interval(pair.interval),
            interval(pair.interval_of_levels),
            seeds.join(", ")
        ));
    }
    (!differences.is_empty()).then_some(text)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::experiment::report::tests::{cell, seed};

    fn method(method: Method, successes: [Option<u32>; 3]) -> CellReport {
        let seeds = (0..).zip(successes).map(|(nth, successes)| seed(nth, successes, None)).collect();
        cell(&method.title(), CellSettings { method, ..CellSettings::default() }, seeds)
    }

    #[test]
    fn methods_are_compared_seed_by_seed() {
        let cells =
            [method(Method::SSDF, [Some(8), Some(6), Some(7)]), method(Method::SSDF_BASE, [Some(3), Some(2), Some(4)])];
        let found = differences(TableKind::Methods, &cells);
        assert_eq!(found.len(), 1);
        let [one] = &found[..] else { unreachable!() };
        assert_eq!((one.cell.as_str(), one.less.as_str()), ("SSDF", "SSDF-base"));
        // 0.5, 0.4, 0.3: mean 0.4, deviation 0.1.
        let (low, high) = one.interval.unwrap();
        let half = 4.3027 * 0.1 / 3.0_f64.sqrt();
        assert!((one.mean - 0.4).abs() < 1e-12 && (low - 0.4 + half).abs() < 1e-5 && (high - 0.4 - half).abs() < 1e-5);
        let (low, high) = one.interval_of_levels.unwrap();
        assert!(low < one.mean && one.mean < high, "{low} {high}");
        assert!(differences(TableKind::Beta, &cells).is_empty());
    }

    #[test]
    fn only_seeds_of_both_methods_count() {
        let ssdf = method(Method::SSDF, [Some(8), None, Some(7)]);
        let base = method(Method::SSDF_BASE, [Some(3), Some(2), None]);
        let found = differences(TableKind::Methods, &[ssdf, base]);
        assert_eq!(found[0].seeds.iter().map(|seed| seed.seed).collect::<Vec<_>>(), [0]);
        assert_eq!((found[0].mean, found[0].interval), (0.5, None));
        let nothing = [method(Method::SSDF, [Some(8), None, None]), method(Method::BC, [None, Some(2), None])];
        assert!(differences(TableKind::Methods, &nothing).is_empty());
    }

    #[test]
    fn cells_are_compared_with_the_first() {
        let [bc, base] = [Method::BC, Method::SSDF_BASE].map(|of| method(of, [Some(3), Some(2), Some(4)]));
        let ssdf = method(Method::SSDF, [Some(5), Some(2), Some(5)]);
        let found = differences(TableKind::Cells, &[bc, base, ssdf]);
        let shown: Vec<_> = found.iter().map(|one| (one.cell.as_str(), one.less.as_str(), one.mean)).collect();
        let third = shown[1].2;
        assert_eq!(shown, [("SSDF-base", "BC", 0.0), ("SSDF", "BC", third)]);
        assert!((third - 0.1).abs() < 1e-12 && found[0].interval.is_none() && found[0].interval_of_levels.is_some());
        assert!(differences(TableKind::Cells, &[]).is_empty());
    }

    #[test]
    fn methods_with_different_settings_are_not_compared() {
        let mut base = method(Method::SSDF_BASE, [Some(3), Some(2), Some(4)]);
        base.settings.train.insert("steps".into(), 9.into());
        assert!(differences(TableKind::Methods, &[method(Method::SSDF, [Some(8); 3]), base]).is_empty());
    }
}
