//! A study's plots: which there are, and what goes into each.

use super::report::{CellReport, Report, SeedReport, StudyReport};
use super::study::TableKind;
use super::tables::behaviour;
use crate::failure::Result;
use crate::figure::{Axis, Bar, Line, bars, lines, spread, two_panels};

/// The room for the labels under the bars of a plot, and that of a character of them, in pixels.
const ROOM: usize = 620;
const CHARACTER: usize = 7;
const SUCCESS: Axis<'static> = Axis { name: "success, %", low: 0.0, high: 100.0 };

/// The file names of a study's plots, in the report's order. `number` counts studies from 1.
pub(crate) fn names(number: usize, study: &StudyReport) -> Vec<String> {
    let mut names = Vec::new();
    if study.cells.iter().any(|cell| cell.pooled.success.is_some() || cell.auroc().is_some()) {
        names.push(format!("study_{number}.svg"));
    }
    if histogram(study).is_some() {
        names.push(format!("study_{number}_q.svg"));
    }
    names
}

/// The labels of the bars, where the bars have numbers since there is no room for labels beside each other.
pub(crate) fn legend(study: &StudyReport) -> Option<String> {
    let drawn = drawn(study);
    let are_lines = study.table == TableKind::Quantity && drawn.iter().any(|(_, cell)| cell.pooled.success.is_some());
    if drawn.is_empty() || are_lines || has_room(study) {
        return None;
    }
    let entries: Vec<String> = drawn.iter().map(|(number, cell)| format!("{number} {}", cell.label)).collect();
    Some(format!("Bars of the first plot: {}.", entries.join("; ")))
}

/// The cells of the main plot, each with its number in the table: those with a success, or else with an AUROC.
fn drawn(study: &StudyReport) -> Vec<(usize, &CellReport)> {
    let of = |has: fn(&CellReport) -> bool| (1..).zip(&study.cells).filter(|(_, cell)| has(cell)).collect::<Vec<_>>();
    let succeeded = of(|cell| cell.pooled.success.is_some());
    if succeeded.is_empty() { of(|cell| cell.auroc().is_some()) } else { succeeded }
}

/// Whether the labels have room beside each other.
fn has_room(study: &StudyReport) -> bool {
    let drawn = drawn(study);
    let longest = drawn.iter().map(|(_, cell)| cell.label.chars().count()).max().unwrap_or(0);
    (longest + 1) * CHARACTER * drawn.len() <= ROOM
}

/// A study's plots with their file names.
pub(crate) fn draw(report: &Report, number: usize, study: &StudyReport) -> Result<Vec<(String, String)>> {
    let mut names = names(number, study).into_iter();
    let mut plots = Vec::new();
    if study.cells.iter().any(|cell| cell.pooled.success.is_some() || cell.auroc().is_some())
        && let Some(name) = names.next()
    {
        plots.push((name, main_plot(report, study)?));
    }
    if let (Some((cell, seed)), Some(name)) = (histogram(study), names.next()) {
        let of = format!("{}, seed {}", cell.label, seed.seed);
        plots.push((name, spread(&of, &seed.histogram, &seed.experts, &seed.cohorts)?));
    }
    Ok(plots)
}

fn main_plot(report: &Report, study: &StudyReport) -> Result<String> {
    let (drawn, has_room) = (drawn(study), has_room(study));
    let labelled = |of: fn(&CellReport) -> Option<Bar>| -> Vec<Bar> {
        let bar = |(number, cell): &(usize, &CellReport)| {
            let bar = of(cell)?;
            Some(if has_room { bar } else { Bar { label: number.to_string(), ..bar } })
        };
        drawn.iter().filter_map(bar).collect()
    };
    let success = labelled(rate);
    if success.is_empty() {
        let axis = Axis { name: "AUROC of q", low: 0.0, high: 1.0 };
        return bars(&study.name, axis, &labelled(auroc));
    }
    match study.table {
        TableKind::Beta => {
            let kept = labelled(kept);
            let most = kept.iter().map(|bar| bar.value).fold(1.0, f64::max);
            let axis = Axis { name: "reserved segments", low: 0.0, high: most * 1.2 };
            two_panels(&study.name, (SUCCESS, &success), (axis, &kept))
        }
        TableKind::Quantity => {
            let x = Axis { name: "success of the agents that recorded, %", low: 0.0, high: 100.0 };
            let cells: Vec<&CellReport> = drawn.iter().map(|(_, cell)| *cell).collect();
            lines(&study.name, x, SUCCESS, &by_ratio(report, &cells))
        }
        TableKind::Objectives | TableKind::Similarity | TableKind::Methods | TableKind::Scoring | TableKind::Cells => {
            bars(&study.name, SUCCESS, &success)
        }
    }
}

fn rate(cell: &CellReport) -> Option<Bar> {
    let success = cell.pooled.success?;
    let interval = Some((success.low * 100.0, success.high * 100.0));
    Some(Bar { label: cell.label.clone(), value: success.rate * 100.0, interval })
}

fn kept(cell: &CellReport) -> Option<Bar> {
    Some(Bar { label: cell.label.clone(), value: cell.pooled.kept.unwrap_or_default(), interval: None })
}

fn auroc(cell: &CellReport) -> Option<Bar> {
    let auroc = cell.auroc()?;
    Some(Bar { label: cell.label.clone(), value: auroc.mean, interval: auroc.interval })
}

// A line for each ratio of imperfect episodes to experts, over how good the agents were.
fn by_ratio(report: &Report, cells: &[&CellReport]) -> Vec<Line> {
    let mut series: Vec<Line> = Vec::new();
    for cell in cells {
        let ratio = cell.settings.rule.imperfect_per_expert;
        let name = if ratio > 0.0 { format!("1:{ratio}") } else { "all".into() };
        let (Some(x), Some(success)) = (behaviour(report, cell), cell.pooled.success) else { continue };
        let point = (x * 100.0, success.rate * 100.0, (success.low * 100.0, success.high * 100.0));
        match series.iter_mut().find(|line| line.name == name) {
            Some(line) => line.points.push(point),
            None => series.push(Line { name, points: vec![point] }),
        }
    }
    for line in &mut series {
        line.points.sort_by(|one, two| one.0.total_cmp(&two.0));
    }
    series
}

// The first cell and seed that has scores.
fn histogram(study: &StudyReport) -> Option<(&CellReport, &SeedReport)> {
    let mut seeds = study.cells.iter().flat_map(|cell| cell.seeds.iter().map(move |seed| (cell, seed)));
    seeds.find(|(_, seed)| !seed.histogram.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::experiment::cell::{CellSettings, RuleSettings};
    use crate::experiment::report::tests::{cell, report, seed};

    #[test]
    fn every_kind_of_study_is_drawn_under_the_names_in_the_report() {
        let mut study = report().studies.remove(0);
        for table in [TableKind::Methods, TableKind::Beta, TableKind::Quantity, TableKind::Scoring] {
            study.table = table;
            let plots = draw(&report(), 2, &study).unwrap();
            let drawn: Vec<String> = plots.iter().map(|plot| plot.0.clone()).collect();
            assert_eq!(drawn, names(2, &study));
            assert_eq!(drawn, ["study_2.svg", "study_2_q.svg"]);
            assert!(plots.iter().all(|plot| plot.1.starts_with("<svg")));
            assert!(plots[1].1.contains("\nSSDF, seed 0\n"), "the plot of q names its cell: {}", plots[1].1);
            assert!(plots[1].1.contains("\nfreeze\n"), "the plot of q names its cohorts: {}", plots[1].1);
        }
    }

    #[test]
    fn bars_whose_labels_have_no_room_are_numbered_as_in_the_table() {
        let labels = ["experts only", "not yet", "the best fifth by raw segments", "everything", "the good steps"];
        let mut study = report().studies.remove(0);
        assert_eq!(legend(&study), None);
        study.table = TableKind::Cells;
        let successes = |label: &str| if label == "not yet" { None } else { Some(5) };
        let of = |label: &&str| cell(label, CellSettings::default(), vec![seed(0, successes(label), None)]);
        study.cells = labels.iter().map(of).collect();
        let svg = draw(&report(), 1, &study).unwrap().remove(0).1;
        for (number, label) in (1..).zip(labels) {
            let expected = usize::from(label != "not yet");
            assert_eq!(svg.matches(&format!("\n{number}\n")).count(), expected, "{number} in {svg}");
            assert!(!svg.contains(&format!("\n{label}\n")), "{label} in {svg}");
        }
        let expected =
            "Bars of the first plot: 1 experts only; 3 the best fifth by raw segments; 4 everything; 5 the good steps.";
        assert_eq!(legend(&study).as_deref(), Some(expected));
    }

    #[test]
    fn a_study_without_results_has_no_plot() {
        let mut study = report().studies.remove(0);
        study.cells.clear();
        assert!(draw(&report(), 1, &study).unwrap().is_empty());
    }

    #[test]
    fn ratios_are_lines_from_bad_agents_to_good_ones() {
        let mut report = report();
        report.recorded.push(crate::experiment::recordings::CohortCount {
            cohort: "weak".into(),
            agent: "noise:1".into(),
            episodes: 5,
            steps: 9,
            successes: 0,
        });
        let quantity = |cohort: &str, ratio| {
            let rule =
                RuleSettings { cohorts: vec![cohort.into()], imperfect_per_expert: ratio, ..RuleSettings::default() };
            cell("x", CellSettings { rule, ..CellSettings::default() }, vec![seed(0, Some(5), None)])
        };
        let cells = [quantity("freeze", 1.0), quantity("weak", 1.0), quantity("weak", 3.0)];
        let series = by_ratio(&report, &cells.iter().collect::<Vec<_>>());
        assert_eq!(series.iter().map(|line| line.name.as_str()).collect::<Vec<_>>(), ["1:1", "1:3"]);
        assert_eq!(series[0].points.iter().map(|point| point.0).collect::<Vec<_>>(), [0.0, 20.0]);
    }
}
