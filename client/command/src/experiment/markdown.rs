//! The report as Markdown, for people.

use std::fmt::Write as _;
use std::time::Duration;

use super::auroc;
use super::difference;
use super::escape::cell;
use super::plots;
use super::report::{Report, SeedReport, StudyReport};
use super::standing::Progress;
use super::tables;
use crate::words;

/// The whole report. Plots are beside it, by the names that `plots` gives them.
pub(crate) fn markdown(report: &Report) -> String {
    let mut text = format!(
        "# {}: {}\n\nMade by `{}` on {} ({}).\n",
        report.name,
        report.task,
        report.command,
        report.device,
        words::counted(report.cores, "core", "cores")
    );
    let Progress { cells, complete, failed, .. } = report.progress;
    if report.progress.unfinished() {
        let gaps = "Columns without all seeds are marked; results that do not exist yet are shown as -.";
        line(&mut text, format_args!("\n**Unfinished: {complete} of {cells} cells are complete. {gaps}**"));
    }
    if failed > 0 {
        line(&mut text, format_args!("\n**{failed} of {cells} cells lack seeds that failed: see Problems.**\n"));
        text.push_str(&lacking(report));
    }
    recorded(report, &mut text);
    for (number, study) in (1..).zip(&report.studies) {
        section(report, number, study, &mut text);
    }
    time(report, &mut text);
    problems(report, &mut text);
    text
}

// Which cells lack which failed seeds, and what is left of them; those of a study that lack the same are one line.
fn lacking(report: &Report) -> String {
    let mut lines: Vec<(String, Vec<&str>)> = Vec::new();
    for study in &report.studies {
        for cell in &study.cells {
            let failed = cell.seeds.iter().filter(|seed| seed.problem.is_some());
            let failed: Vec<String> = failed.map(|seed| seed.seed.to_string()).collect();
            if failed.is_empty() {
                continue;
            }
            let left = match (cell.complete_seeds(), cell.seeds.len()) {
                (0, _) => "no seed is complete".to_owned(),
                (complete, all) => format!("means are over {complete} of {all} seeds"),
            };
            let seeds = if failed.len() == 1 { "seed" } else { "seeds" };
            let lacks = format!("- {}, without {seeds} {} ({left}): ", study.name, failed.join(", "));
            match lines.iter_mut().find(|line| line.0 == lacks) {
                Some(line) => line.1.push(&cell.label),
                None => lines.push((lacks, vec![&cell.label])),
            }
        }
    }
    lines.iter().map(|(lacks, cells)| format!("{lacks}{}\n", cells.join(", "))).collect()
}

fn recorded(report: &Report, text: &mut String) {
    line(text, "\n## Recordings\n\n| cohort | agent | episodes | steps | succeeded |\n|---|---|---:|---:|---:|");
    for row in &report.recorded {
        let share = words::percent(row.successes, row.episodes);
        // Of recordings made elsewhere, who made them is in the name of the cohort.
        let agent = if row.agent.is_empty() { "-".to_owned() } else { cell(&row.agent) };
        line(text, format_args!("| {} | {agent} | {} | {} | {share} |", cell(&row.cohort), row.episodes, row.steps));
    }
}

fn section(report: &Report, number: usize, study: &StudyReport, text: &mut String) {
    line(text, format_args!("\n## {}\n", study.name));
    let mut seeds: Vec<u64> = study.cells.iter().flat_map(|cell| cell.seeds.iter().map(|seed| seed.seed)).collect();
    seeds.sort_unstable();
    seeds.dedup();
    let of_all =
        if study.cells.iter().all(|cell| cell.seeds.len() == seeds.len()) { "" } else { ", not of every cell" };
    let seeds: Vec<String> = seeds.iter().map(ToString::to_string).collect();
    let evaluated = study.cells.iter().filter(|cell| cell.settings.evaluate);
    let mut episodes: Vec<u32> = evaluated.map(|cell| cell.settings.episodes).collect();
    episodes.sort_unstable();
    episodes.dedup();
    let numbers: Vec<String> = episodes.iter().map(ToString::to_string).collect();
    let episodes = match numbers[..] {
        [] => "no policies are trained".to_owned(),
        _ if episodes == [1] => "1 evaluation episode for each seed".to_owned(),
        _ => format!("{} evaluation episodes for each seed", numbers.join(" or ")),
    };
    line(
        text,
        format_args!(
            "`{}`; {} {}{of_all}; {episodes}; {} of machine time in {} (those shared with other studies count in each).\n",
            report.command,
            if seeds.len() == 1 { "seed" } else { "seeds" },
            seeds.join(", "),
            words::duration(Duration::from_secs_f64(study.machine_seconds.max(0.0))),
            words::counted(study.stages, "stage", "stages")
        ),
    );
    text.push_str(&tables::summary(report, study));
    if let Some(table) = difference::table(&study.differences) {
        line(
            text,
            "\nDifferences of success under the same seeds: the same recordings and attempts, and the same encoder where cells share one.\n",
        );
        text.push_str(&table);
    }
    for plot in plots::names(number, study) {
        line(text, format_args!("\n![{}]({plot})", study.name));
    }
    if let Some(legend) = plots::legend(study) {
        line(text, format_args!("\n{legend}"));
    }
    if let Some(table) = tables::auroc(study) {
        line(
            text,
            "\nAUROC of q against the marks: the mean over seeds, and the widest bounds of the seeds' 95 % \
             intervals (episodes resampled).\n",
        );
        text.push_str(&table);
        if let Some(differences) = auroc::table(&study.auroc_differences) {
            line(
                text,
                "\nDifferences of AUROC over all segments: the mean over seeds, and the widest bounds of the seeds' 95 % \
                 intervals (the same episodes resampled for both).\n",
            );
            text.push_str(&differences);
        }
        if let Some(mild) = tables::mild(report, study) {
            line(text, format_args!("\n{mild}"));
        }
    }
    line(text, "\nSeed by seed:\n");
    text.push_str(&tables::seeds(study));
}

fn time(report: &Report, text: &mut String) {
    line(text, "\n## Time\n\n| stage | jobs | machine time | each |\n|---|---:|---:|---:|");
    let mut kinds: Vec<&str> = Vec::new();
    for stage in &report.stages {
        if stage.seconds.is_some() && !kinds.contains(&stage.kind.as_str()) {
            kinds.push(&stage.kind);
        }
    }
    let mut whole = 0.0;
    for kind in kinds {
        let took: Vec<f64> =
            report.stages.iter().filter(|stage| stage.kind == kind).filter_map(|stage| stage.seconds).collect();
        let sum: f64 = took.iter().sum();
        let each = crate::quality::mean(&took).unwrap_or_default();
        let [sum_text, each] = [sum, each].map(|seconds| words::duration(Duration::from_secs_f64(seconds.max(0.0))));
        line(text, format_args!("| {kind} | {} | {sum_text} | {each} |", took.len()));
        whole += sum;
    }
    line(text, format_args!("| all | | {} | |", words::duration(Duration::from_secs_f64(whole.max(0.0)))));
}

fn problems(report: &Report, text: &mut String) {
    let mut lines = Vec::new();
    for study in &report.studies {
        for cell in &study.cells {
            let problem = |seed: &SeedReport| {
                let problem = seed.problem.as_ref()?;
                Some(format!("- {}, {}, seed {}: {problem}", study.name, cell.label, seed.seed))
            };
            lines.extend(cell.seeds.iter().filter_map(problem));
        }
    }
    if !lines.is_empty() {
        line(text, format_args!("\n## Problems\n\n{}", lines.join("\n")));
    }
}

fn line(text: &mut String, line: impl std::fmt::Display) {
    // Writing into a String can't fail.
    let _ = writeln!(text, "{line}");
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::experiment::report::CellReport;
    use crate::experiment::report::tests::report;

    #[test]
    fn an_unfinished_report_states_what_is_missing() {
        let mut report = report();
        let seed = &mut report.studies[0].cells[2].seeds[1];
        (seed.problem, seed.unfinished) = (None, true);
        let (studies, stages) = (report.studies.clone(), report.stages.clone());
        let text = markdown(&report.found(studies, stages));
        assert!(text.contains("**Unfinished: 2 of 3 cells are complete"), "{text}");
        assert!(!text.contains("failed") && !text.contains("## Problems"), "{text}");
        assert!(text.contains("| | BC | SSDF-base | SSDF (1 of 2 seeds) |"), "{text}");
        assert!(text.contains("| SSDF | 1 | not yet | - |"), "{text}");
    }

    #[test]
    fn a_cell_with_a_failed_seed_and_an_outstanding_one_is_unfinished() {
        let mut report = report();
        let outstanding = SeedReport { seed: 2, unfinished: true, ..SeedReport::default() };
        report.studies[0].cells[2].seeds.push(outstanding);
        let (studies, stages) = (report.studies.clone(), report.stages.clone());
        let text = markdown(&report.found(studies, stages));
        assert!(text.contains("**Unfinished: 2 of 3 cells are complete"), "{text}");
        assert!(text.contains("**1 of 3 cells lack seeds that failed"), "{text}");
        assert!(text.contains("seeds 0, 1, 2, not of every cell; 10 evaluation episodes"), "{text}");
    }

    #[test]
    fn the_head_of_a_study_has_each_number_of_episodes() {
        let mut report = report();
        report.studies[0].cells[0].settings.episodes = 50;
        assert!(markdown(&report).contains("; seeds 0, 1; 10 or 50 evaluation episodes for each seed;"));
        let study = &mut report.studies[0];
        study.stages = 1;
        for cell in &mut study.cells {
            cell.settings.episodes = 1;
            cell.seeds.truncate(1);
        }
        let text = markdown(&report);
        assert!(
            text.contains("; seed 0; 1 evaluation episode for each seed;") && text.contains(" in 1 stage ("),
            "{text}"
        );
        report.studies[0].cells.iter_mut().for_each(|cell| cell.settings.evaluate = false);
        assert!(markdown(&report).contains("; no policies are trained;"));
    }

    #[test]
    fn the_head_lists_failed_seeds_and_counts_complete_ones() {
        let mut report = report();
        let again = report.studies[0].cells[2].clone();
        report.studies[0].cells.push(CellReport { label: "other".into(), ..again.clone() });
        let seeds = again.seeds.into_iter().map(|seed| SeedReport { problem: Some("no memory".into()), ..seed });
        let none = CellReport { label: "none".into(), seeds: seeds.collect(), ..report.studies[0].cells[0].clone() };
        report.studies[0].cells.push(none);
        let (studies, stages) = (report.studies.clone(), report.stages.clone());
        let text = markdown(&report.found(studies, stages));
        let head = text.split("\n## ").next().unwrap();
        for line in [
            "**3 of 5 cells lack seeds that failed: see Problems.**",
            "- Methods, without seed 1 (means are over 1 of 2 seeds): SSDF, other",
            "- Methods, without seeds 0, 1 (no seed is complete): none",
        ] {
            assert!(head.lines().any(|shown| shown == line), "{line} in {head}");
        }
    }

    #[test]
    fn a_label_with_a_bar_stays_in_its_cell_of_each_table() {
        let mut report = report();
        let study = &mut report.studies[0];
        for (label, cell) in ["a|b", "c", "d | e\nf"].into_iter().zip(&mut study.cells) {
            cell.label = label.into();
            cell.pooled.auroc.iter_mut().for_each(|auroc| auroc.cohort = format!("x|{}", auroc.cohort));
        }
        for difference in &mut study.differences {
            (difference.cell, difference.less) = ("d | e".into(), "a|b".into());
        }
        let (less, interval) = ("c".into(), (0.0, 1.0));
        let of_auroc = super::auroc::AurocDifference { cell: "a|b".into(), less, mean: 0.5, interval, seeds: 1 };
        study.auroc_differences = vec![of_auroc];
        report.recorded[1].cohort = "free|ze".into();
        let text = markdown(&report);
        let bars = |line: &str| line.replace("\\|", "").matches('|').count();
        let mut width = None;
        for line in text.lines() {
            let own = line.starts_with('|').then(|| bars(line));
            assert!(own.is_none() || width.is_none() || own == width, "{line} in {text}");
            width = own;
        }
        assert!(text.contains("| free\\|ze |") && text.contains("| d \\| e f | 1 | failed |"), "{text}");
    }

    #[test]
    fn a_fixed_report_equals_the_committed_one() {
        let expected = include_str!("testdata/report.md");
        let read: Report = serde_json::from_str(&serde_json::to_string(&report()).unwrap()).unwrap();
        assert_eq!(markdown(&read), expected, "if this is meant, copy what is left of == into testdata/report.md");
    }
}
