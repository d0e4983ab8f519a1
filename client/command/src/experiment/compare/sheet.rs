//! The numbers of a comparison as CSV: one row for each value, with what it is of. Values that could not be computed
//! have no row.

use super::super::rate::Rate;
use super::report::{Auroc, Comparison, ScorerReport, Separated, Success};
use crate::failure::{Failure, Result};

/// The columns: of which scorer (or pair), which measure, over which group, and its value.
const HEADER: [&str; 4] = ["scorer", "measure", "group", "value"];

/// The whole file.
pub(super) fn csv(found: &Comparison) -> Result<String> {
    let wrong = |error: &dyn std::fmt::Display| Failure::message(format!("scorers.csv: {error}"));
    let mut writer = csv::Writer::from_writer(Vec::new());
    writer.write_record(HEADER).map_err(|error| wrong(&error))?;
    for (scorer, measure, group, value) in values(found) {
        writer.write_record([&scorer, measure, &group, &value.to_string()]).map_err(|error| wrong(&error))?;
    }
    let bytes = writer.into_inner().map_err(|error| wrong(&error))?;
    String::from_utf8(bytes).map_err(|error| wrong(&error))
}

type Row = (String, &'static str, String, f64);

fn values(found: &Comparison) -> Vec<Row> {
    let mut rows = Vec::new();
    for scorer in &found.scorers {
        separated(&scorer.label, &scorer.separated, &mut rows);
        own(scorer, &mut rows);
    }
    for (label, alone) in found.alone() {
        separated(label, alone, &mut rows);
    }
    for pair in &found.agreement {
        let both = format!("{} / {}", pair.one, pair.other);
        let mut add =
            |measure, value: Option<f64>| rows.extend(value.map(|value| (both.clone(), measure, String::new(), value)));
        add("agreement", pair.spearman);
        add("overlap", pair.overlap);
    }
    rows
}

#[expect(clippy::cast_precision_loss, reason = "counts of pairs are far below 2^52")]
fn separated(label: &str, separated: &Separated, rows: &mut Vec<Row>) {
    let groups =
        separated.marked.iter().map(|auroc| (auroc, "marked")).chain(separated.outcome.iter().map(|auroc| (auroc, "")));
    for (Auroc { pooled, equal_length, pairs, equal_step, step_pairs }, kind) in groups {
        let group = format!("{kind} {}", pooled.cohort).trim_start().to_owned();
        let mut add = |measure, value: Option<f64>| {
            rows.extend(value.map(|value| (label.to_owned(), measure, group.clone(), value)))
        };
        add("auroc", Some(pooled.mean));
        add("auroc_low", pooled.interval.map(|interval| interval.0));
        add("auroc_high", pooled.interval.map(|interval| interval.1));
        add("auroc_equal_length", *equal_length);
        add("pairs_equal_length", equal_length.map(|_| *pairs as f64));
        add("auroc_equal_step", *equal_step);
        add("pairs_equal_step", equal_step.map(|_| *step_pairs as f64));
    }
}

fn own(scorer: &ScorerReport, rows: &mut Vec<Row>) {
    let mut add = |measure, group: &str, value: Option<f64>| {
        rows.extend(value.map(|value| (scorer.label.clone(), measure, group.to_owned(), value)));
    };
    for length in &scorer.length {
        add("length_correlation", &length.group, length.spearman);
    }
    add("stability", "", scorer.stability);
    let Success { pooled, mean_of_seeds, interval_of_seeds, precision, recall } = scorer.success;
    let of_rate = |of: fn(&Rate) -> f64| pooled.as_ref().map(of);
    add("success", "", mean_of_seeds);
    add("success_low", "wilson", of_rate(|rate| rate.low));
    add("success_high", "wilson", of_rate(|rate| rate.high));
    add("success_low", "seeds", interval_of_seeds.map(|interval| interval.0));
    add("success_high", "seeds", interval_of_seeds.map(|interval| interval.1));
    add("precision", "best part", precision);
    add("recall", "best part", recall);
    for seed in &scorer.seeds {
        add("success", &format!("seed {}", seed.seed), seed.success.map(|rate| rate.rate));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::experiment::compare::markdown::tests::comparison;

    #[test]
    fn every_value_is_a_row_and_missing_ones_have_none() {
        let text = csv(&comparison()).unwrap();
        let rows: Vec<&str> = text.lines().collect();
        assert_eq!(rows[0], "scorer,measure,group,value");
        for row in [
            "ssdf,auroc,marked all,0.9",
            "ssdf,pairs_equal_length,marked all,12",
            "ssdf,auroc_equal_step,marked all,0.7",
            "ssdf,pairs_equal_step,marked all,6",
            "step alone,auroc,marked all,0.95",
            "length alone,auroc,marked all,0.75",
            "ssdf / raw local_scale=false,agreement,,0.5",
            "ssdf,success,seed 0,0.5",
        ] {
            assert!(rows.contains(&row), "{row} in {text}");
        }
        assert!(!text.contains("raw local_scale=false,stability"), "one run has no stability: {text}");
    }
}
