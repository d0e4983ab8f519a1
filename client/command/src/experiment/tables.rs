//! A study's tables in Markdown, in the paper's form: a column for each cell, a row for each measure.

use gleaner_core::kinds::Family;
use gleaner_sim::AgentSpec;
use serde_json::Value;

use super::escape::cell as escaped;
use super::report::{CellReport, PooledAuroc, Report, SeedReport, StudyReport};
use super::study::TableKind;
use crate::quality::{ALL, mean};
use crate::words;

const GAP: &str = "-";

/// Whether a cell pretrains by this objective; all of them when none is named.
fn trains_by(cell: &CellReport, objective: &str) -> bool {
    let settings = &cell.settings;
    let named = settings.pretrain.get("objectives").or_else(|| settings.settings.get("objectives"));
    named.and_then(Value::as_array).is_none_or(|named| named.iter().any(|name| name == objective))
}

/// The study's own table.
pub(crate) fn summary(report: &Report, study: &StudyReport) -> String {
    let mut rows: Vec<(String, Vec<String>)> = Vec::new();
    let mut row = |name: &str, of: &dyn Fn(&CellReport) -> Option<String>| {
        let values: Vec<Option<String>> = study.cells.iter().map(of).collect();
        if values.iter().any(Option::is_some) {
            rows.push((name.to_owned(), values.into_iter().map(|value| value.unwrap_or_else(|| GAP.into())).collect()));
        }
    };
    if study.table == TableKind::Objectives {
        for objective in Family::Objective.kinds() {
            row(&objective.title, &|cell| {
                Some(if trains_by(cell, &objective.name) { "✓".into() } else { String::new() })
            });
        }
    }
    if study.table == TableKind::Quantity {
        row("behaviour success, %", &|cell| behaviour(report, cell).map(percent));
    }
    row("success, %", &|cell| cell.pooled.mean_of_seeds.map(percent));
    row("95 % Wilson interval over episodes", &|cell| {
        cell.pooled.success.map(|rate| span(rate.low * 100.0, rate.high * 100.0, 1))
    });
    row("95 % t-interval over seeds", &|cell| {
        cell.pooled.interval_of_seeds.map(|(low, high)| span(low * 100.0, high * 100.0, 1))
    });
    row("95 % bootstrap over seeds and attempts", &|cell| {
        cell.pooled.interval_of_levels.map(|(low, high)| span(low * 100.0, high * 100.0, 1))
    });
    row("successes", &|cell| cell.pooled.success.map(|rate| format!("{} of {}", rate.successes, rate.episodes)));
    row("deviation of seeds, %", &|cell| cell.pooled.deviation_of_seeds.map(percent));
    row("reserved segments", &|cell| cell.pooled.kept.map(|kept| format!("{kept:.0}")));
    row("of which good (precision), %", &|cell| cell.pooled.precision.map(percent));
    row("of the good kept (recall), %", &|cell| cell.pooled.recall.map(percent));
    for input in inputs(study) {
        row(&format!("looks at {input}"), &|cell| look(cell, &input).map(|share| format!("{share:.2}")));
    }
    row("AUROC of q", &|cell| cell.auroc().map(|auroc| three(auroc.mean)));
    let labels: Vec<String> = study.cells.iter().map(label).collect();
    transposed(&labels, &rows)
}

/// The inputs that the cells' policies look at, in the order of their reports.
fn inputs(study: &StudyReport) -> Vec<String> {
    let mut inputs: Vec<String> = Vec::new();
    for look in study.cells.iter().flat_map(|cell| &cell.seeds).flat_map(|seed| &seed.looks) {
        if !inputs.contains(&look.input) {
            inputs.push(look.input.clone());
        }
    }
    inputs
}

/// The share of the action that an input explains, mean over the cell's seeds.
fn look(cell: &CellReport, input: &str) -> Option<f64> {
    let looks = cell.seeds.iter().flat_map(|seed| &seed.looks).filter(|look| look.input == input);
    mean(&looks.map(|look| look.share).collect::<Vec<_>>())
}

// A cell's label, and how much of it there is when that is not all.
fn label(cell: &CellReport) -> String {
    match (cell.complete_seeds(), cell.seeds.len()) {
        (complete, all) if complete == all => cell.label.clone(),
        (complete, all) => format!("{} ({complete} of {all} seeds)", cell.label),
    }
}

/// AUROC by cohort, when any cell has scores. Cells with the same scores (at other β, say) are one column.
pub(crate) fn auroc(study: &StudyReport) -> Option<String> {
    let mut columns: Vec<(String, &[PooledAuroc])> = Vec::new();
    for cell in study.cells.iter().filter(|cell| !cell.pooled.auroc.is_empty()) {
        match columns.iter_mut().find(|column| column.1 == cell.pooled.auroc) {
            Some(column) => column.0 = format!("{}, {}", column.0, cell.label),
            None => columns.push((cell.label.clone(), &cell.pooled.auroc)),
        }
    }
    let mut cohorts: Vec<&str> = Vec::new();
    for pooled in columns.iter().flat_map(|column| column.1) {
        if !cohorts.contains(&pooled.cohort.as_str()) {
            cohorts.push(&pooled.cohort);
        }
    }
    let value = |column: &[PooledAuroc], cohort: &str| {
        let found = column.iter().find(|auroc| auroc.cohort == cohort);
        found.map_or_else(|| GAP.to_owned(), with_interval)
    };
    let rows: Vec<(&str, Vec<String>)> = cohorts
        .iter()
        .map(|cohort| (*cohort, columns.iter().map(|column| value(column.1, cohort)).collect()))
        .collect();
    let labels: Vec<String> = columns.iter().map(|column| column.0.clone()).collect();
    (!rows.is_empty()).then(|| transposed(&labels, &rows))
}

/// What to know of the rows over all cohorts: which agents go wrong less than they could, so that their bad steps are
/// few and mild.
pub(crate) fn mild(report: &Report, study: &StudyReport) -> Option<String> {
    let shown =
        |cohort: &str| study.cells.iter().flat_map(|cell| &cell.pooled.auroc).any(|auroc| auroc.cohort == cohort);
    let below = |agent: &str| agent.parse::<AgentSpec>().is_ok_and(|agent| agent.grade() < 1.0);
    let mild: Vec<String> = report
        .recorded
        .iter()
        .skip(1)
        .filter(|count| shown(&count.cohort) && below(&count.agent))
        .map(|count| {
            format!("{} ({}, {} succeeded)", count.cohort, count.agent, words::percent(count.successes, count.episodes))
        })
        .collect();
    (!mild.is_empty()).then(|| format!("`{ALL}` counts cohorts of a low grade too: {}.", mild.join(", ")))
}

/// One line for each cell and seed.
pub(crate) fn seeds(study: &StudyReport) -> String {
    let mut text = String::from(
        "| cell | seed | successes | 95 % Wilson interval | reserved | precision | recall | AUROC of q |\n\
         |---|---:|---|---|---:|---:|---:|---|\n",
    );
    for cell in &study.cells {
        for seed in &cell.seeds {
            text.push_str(&format!("| {} | {} | {} |\n", escaped(&cell.label), seed.seed, measures(seed).join(" | ")));
        }
    }
    text
}

fn measures(seed: &SeedReport) -> [String; 6] {
    let gap = || GAP.to_owned();
    let selected = seed.selected.as_ref();
    let share = |value: Option<f64>| value.map_or_else(gap, |value| format!("{} %", percent(value)));
    let successes = match (&seed.success, &seed.problem) {
        (Some(rate), _) => format!("{} of {}", rate.successes, rate.episodes),
        (None, Some(_)) => "failed".into(),
        (None, None) if seed.unfinished => "not yet".into(),
        (None, None) => gap(),
    };
    [
        successes,
        seed.success.map_or_else(gap, |rate| span(rate.low * 100.0, rate.high * 100.0, 1)),
        selected.map_or_else(gap, |kept| format!("{} of {}", kept.kept, kept.of)),
        share(selected.and_then(|kept| kept.precision)),
        share(selected.and_then(|kept| kept.recall)),
        seed.separation.first().and_then(|all| Some((all.auroc?, all.interval))).map_or_else(
            gap,
            |(auroc, interval)| {
                interval
                    .map_or_else(|| three(auroc), |(low, high)| format!("{} ({})", three(auroc), span(low, high, 3)))
            },
        ),
    ]
}

/// How often the agents succeed whose episodes a cell takes as imperfect.
pub(crate) fn behaviour(report: &Report, cell: &CellReport) -> Option<f64> {
    let named = &cell.settings.rule.cohorts;
    let imperfect = || report.recorded.iter().skip(1).filter(|count| named.is_empty() || named.contains(&count.cohort));
    let episodes: u64 = imperfect().map(|count| count.episodes).sum();
    let successes: u64 = imperfect().map(|count| count.successes).sum();
    #[expect(clippy::cast_precision_loss, reason = "counts of episodes are far below 2^52")]
    let share = successes as f64 / episodes.max(1) as f64;
    (episodes > 0).then_some(share)
}

fn transposed<N: AsRef<str>>(labels: &[String], rows: &[(N, Vec<String>)]) -> String {
    let labels: Vec<String> = labels.iter().map(|label| escaped(label)).collect();
    let mut text = format!("| | {} |\n|---|{}\n", labels.join(" | "), "---:|".repeat(labels.len()));
    for (name, values) in rows {
        text.push_str(&format!("| {} | {} |\n", escaped(name.as_ref()), values.join(" | ")));
    }
    text
}

fn with_interval(auroc: &PooledAuroc) -> String {
    let mean = three(auroc.mean);
    auroc.interval.map_or_else(|| mean.clone(), |(low, high)| format!("{mean} ({})", span(low, high, 3)))
}

fn span(low: f64, high: f64, digits: usize) -> String {
    format!("{low:.digits$}–{high:.digits$}")
}

fn three(value: f64) -> String {
    format!("{value:.3}")
}

fn percent(share: f64) -> String {
    format!("{:.1}", share * 100.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::experiment::cell::{CellSettings, RuleSettings};
    use crate::experiment::report::tests::{cell, report, seed};

    fn study(table: TableKind, cells: Vec<CellReport>) -> StudyReport {
        let (differences, auroc_differences) = (Vec::new(), Vec::new());
        StudyReport { name: "x".into(), table, cells, differences, auroc_differences, machine_seconds: 0.0, stages: 0 }
    }

    #[test]
    fn objectives_are_ticked_as_in_the_paper() {
        let with = |objectives: &[&str]| {
            let settings = gleaner_core::Values::from_iter([("objectives".to_owned(), objectives.to_vec().into())]);
            CellSettings { settings, ..CellSettings::default() }
        };
        let cells = vec![
            cell("1", with(&["mtp"]), vec![seed(0, Some(5), None)]),
            cell("2", with(&["mtp", "aa"]), vec![seed(0, Some(6), None)]),
        ];
        let text = summary(&report(), &study(TableKind::Objectives, cells));
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines[2..6], ["| MTP | ✓ | ✓ |", "| TR |  |  |", "| AA |  | ✓ |", "| success, % | 50.0 | 60.0 |"]);
    }

    #[test]
    fn what_a_policy_looks_at_is_a_row_for_each_input() {
        let looking = |share: f64| {
            let look = gleaner_core::looks::Look { input: "images".into(), share };
            crate::experiment::report::SeedReport { looks: vec![look], ..seed(0, Some(5), None) }
        };
        let cells = vec![
            cell("1", CellSettings::default(), vec![looking(0.25), looking(0.75)]),
            cell("2", CellSettings::default(), vec![seed(0, Some(6), None)]),
        ];
        let text = summary(&report(), &study(TableKind::Cells, cells));
        assert!(text.contains("| looks at images | 0.50 | - |"), "{text}");
    }

    #[test]
    fn cells_with_the_same_scores_are_one_column() {
        let scored =
            |label: &str, auroc_of: u64| cell(label, CellSettings::default(), vec![seed(auroc_of, Some(5), Some(3))]);
        let cells = vec![scored("0.5", 0), scored("0.9", 0), scored("other", 1)];
        let text = auroc(&study(TableKind::Beta, cells)).unwrap();
        assert!(text.starts_with("| | 0.5, 0.9 | other |\n"), "{text}");
        assert_eq!(auroc(&study(TableKind::Beta, Vec::new())), None);
    }

    #[test]
    fn mild_agents_among_all_are_named() {
        let scored =
            || study(TableKind::Scoring, vec![cell("x", CellSettings::default(), vec![seed(0, Some(5), Some(3))])]);
        let mut report = report();
        assert_eq!(mild(&report, &scored()), None);
        report.recorded[1].agent = "freeze:0.3".into();
        assert_eq!(
            mild(&report, &scored()).unwrap(),
            "`all` counts cohorts of a low grade too: freeze (freeze:0.3, 20.0 % succeeded)."
        );
        assert_eq!(mild(&report, &study(TableKind::Scoring, Vec::new())), None);
    }

    #[test]
    fn quantity_states_the_success_of_the_agents() {
        let rule = RuleSettings { cohorts: vec!["freeze".into()], ..RuleSettings::default() };
        let settings = CellSettings { rule, ..CellSettings::default() };
        let cells = vec![cell("1:1 freeze", settings, vec![seed(0, Some(5), Some(3))])];
        let text = summary(&report(), &study(TableKind::Quantity, cells));
        assert!(text.contains("| behaviour success, % | 20.0 |"), "{text}");
    }
}
