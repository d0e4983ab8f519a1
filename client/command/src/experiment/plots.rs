//! A study's plots: which there are, and what goes into each.

use super::report::{CellReport, Report, SeedReport, StudyReport};
use super::study::TableKind;
use super::tables::behaviour;
use crate::failure::Result;
use crate::figure::{Axis, Bar, Line, bars, lines, spread, two_panels};

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

/// A study's plots with their file names.
pub(crate) fn draw(report: &Report, number: usize, study: &StudyReport) -> Result<Vec<(String, String)>> {
    let mut names = names(number, study).into_iter();
    let mut plots = Vec::new();
    if study.cells.iter().any(|cell| cell.pooled.success.is_some() || cell.auroc().is_some())
        && let Some(name) = names.next()
    {
        plots.push((name, main_plot(report, study)?));
    }
    if let (Some(seed), Some(name)) = (histogram(study), names.next()) {
        plots.push((name, spread(&seed.histogram, &seed.experts)?));
    }
    Ok(plots)
}

fn main_plot(report: &Report, study: &StudyReport) -> Result<String> {
    let succeeded: Vec<&CellReport> = study.cells.iter().filter(|cell| cell.pooled.success.is_some()).collect();
    if succeeded.is_empty() {
        let axis = Axis { name: "AUROC of q", low: 0.0, high: 1.0 };
        return bars(&study.name, axis, &study.cells.iter().filter_map(auroc).collect::<Vec<_>>());
    }
    let success: Vec<Bar> = succeeded.iter().filter_map(|cell| rate(cell)).collect();
    match study.table {
        TableKind::Beta => {
            let kept = |cell: &&CellReport| Bar {
                label: cell.label.clone(),
                value: cell.pooled.kept.unwrap_or_default(),
                interval: None,
            };
            let kept: Vec<Bar> = succeeded.iter().map(kept).collect();
            let most = kept.iter().map(|bar| bar.value).fold(1.0, f64::max);
            let axis = Axis { name: "reserved segments", low: 0.0, high: most * 1.2 };
            two_panels(&study.name, (SUCCESS, &success), (axis, &kept))
        }
        TableKind::Quantity => {
            let x = Axis { name: "success of the agents that recorded, %", low: 0.0, high: 100.0 };
            lines(&study.name, x, SUCCESS, &by_ratio(report, &succeeded))
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

// Of the first cell and seed that has scores.
fn histogram(study: &StudyReport) -> Option<&SeedReport> {
    study.cells.iter().flat_map(|cell| &cell.seeds).find(|seed| !seed.histogram.is_empty())
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
        }
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
