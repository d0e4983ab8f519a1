//! The demo's report: one structure, as Markdown for people and as JSON for programs.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use serde::Serialize;
use serde_json::Value;

use super::super::cell::CellSettings;
use super::super::escape::cell;
use super::super::recordings::CohortCount;
use crate::quality::{Selected, Separation};
use gleaner_core::NormaliserKind;

/// Everything the demo found.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Report {
    /// Every setting, as in the experiment's file.
    pub(crate) plan: toml::Table,
    /// The settings of the policy with gleaned segments.
    #[serde(skip)]
    pub(crate) cell: CellSettings,
    pub(crate) recorded: Vec<CohortCount>,
    pub(crate) separation: Vec<Separation>,
    /// What a user should look at before they select segments by these scores.
    pub(crate) warnings: Vec<String>,
    pub(crate) thresholds: Vec<Threshold>,
    /// Counts of equal bins of q over [0, 1], by the server.
    pub(crate) histogram: Vec<u64>,
    /// The same of the experts.
    pub(crate) experts: Vec<u64>,
    /// The same of each cohort.
    pub(crate) cohorts: BTreeMap<String, Vec<u64>>,
    pub(crate) policies: Vec<Evaluation>,
    pub(crate) stages: Vec<Stage>,
    /// Duration of all stages; some run side by side.
    pub(crate) seconds: f64,
}

/// What a threshold keeps.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Threshold {
    pub(crate) beta: f64,
    #[serde(flatten)]
    pub(crate) selected: Selected,
}

/// One policy's closed-loop evaluation.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Evaluation {
    /// What it was trained on.
    pub(crate) trained_on: String,
    /// As `gleaner drive --json` shows it.
    pub(crate) result: Value,
    /// The success rate as a sentence.
    pub(crate) success_rate: String,
}

/// How long a stage took.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Stage {
    pub(crate) stage: String,
    pub(crate) seconds: f64,
    /// What it dealt with.
    pub(crate) detail: String,
}

impl Report {
    pub(crate) fn markdown(&self) -> String {
        let mut text = String::from("# gleaner demo: pick_cube\n");
        self.recorded_section(&mut text);
        self.separation_section(&mut text);
        self.threshold_section(&mut text);
        self.policy_section(&mut text);
        self.stage_section(&mut text);
        text
    }

    fn recorded_section(&self, text: &mut String) {
        heading(text, "Recorded in the simulator", "| agent | episodes | steps | succeeded |\n|---|---:|---:|---:|");
        for row in &self.recorded {
            line(
                text,
                format_args!("| {} | {} | {} | {} |", cell(&row.cohort), row.episodes, row.steps, row.successes),
            );
        }
    }

    fn separation_section(&self, text: &mut String) {
        heading(
            text,
            "Does q separate the steps before a failure from those after it?",
            "| imperfect agent | episodes | good steps | wrong steps | mean q good | mean q wrong | AUROC |\n\
             |---|---:|---:|---:|---:|---:|---:|",
        );
        for row in &self.separation {
            let [good, wrong, auroc] = [row.mean_q_good, row.mean_q_wrong, row.auroc].map(number);
            line(
                text,
                format_args!(
                    "| {} | {} | {} | {} | {good} | {wrong} | {auroc} |",
                    cell(&row.cohort),
                    row.episodes,
                    row.good_steps,
                    row.wrong_steps
                ),
            );
        }
        for warning in &self.warnings {
            text.push_str(&format!("\nWarning: {warning}.\n"));
        }
    }

    fn threshold_section(&self, text: &mut String) {
        heading(
            text,
            "Imperfect segments kept by each threshold (q > β)",
            "| β | kept | share | precision | recall |\n|---:|---:|---:|---:|---:|",
        );
        for row in &self.thresholds {
            let kept = &row.selected;
            let [share, precision, recall] = [Some(kept.share), kept.precision, kept.recall].map(percent);
            line(text, format_args!("| {} | {} | {share} | {precision} | {recall} |", row.beta, kept.kept));
        }
    }

    fn policy_section(&self, text: &mut String) {
        heading(
            text,
            "Closed loop over gRPC",
            "| trained on | successes | latency p50 | latency p99 |\n|---|---|---:|---:|",
        );
        for row in &self.policies {
            let milliseconds = |name: &str| format!("{:.1} ms", row.result[name].as_f64().unwrap_or_default());
            line(
                text,
                format_args!(
                    "| {} | {} | {} | {} |",
                    row.trained_on,
                    row.success_rate,
                    milliseconds("latency_p50_ms"),
                    milliseconds("latency_p99_ms")
                ),
            );
        }
        let (episodes, beta) = (self.cell.episodes, self.cell.beta());
        // The plan was checked, so both can be read.
        let training = self.cell.train_spec(0).unwrap_or_default();
        let lambda = training.weighting.settings.get("lambda").unwrap_or(&Value::Null);
        let q = match self.cell.score_spec(0).unwrap_or_default().normaliser {
            NormaliserKind::MinMax => "from the worst segment to the best",
            NormaliserKind::Quantile => "the share of segments that are worse",
            NormaliserKind::Calibrated => "the share of expert steps that are at most as good",
        };
        line(
            text,
            format_args!(
                "\nThe same {episodes} episodes for each, none of them recorded; the dataset's β is {beta}, λ is {lambda}, q is {q}."
            ),
        );
    }

    fn stage_section(&self, text: &mut String) {
        heading(text, "Time", "| stage | seconds | |\n|---|---:|---|");
        for row in &self.stages {
            line(text, format_args!("| {} | {:.1} | {} |", row.stage, row.seconds, row.detail));
        }
        line(text, format_args!("| all | {:.1} | |", self.seconds));
    }
}

fn heading(text: &mut String, title: &str, header: &str) {
    line(text, format_args!("\n## {title}\n\n{header}"));
}

fn line(text: &mut String, line: std::fmt::Arguments<'_>) {
    // Writing into a String can't fail.
    let _ = writeln!(text, "{line}");
}

fn number(value: Option<f64>) -> String {
    value.map_or_else(|| "-".into(), |value| format!("{value:.3}"))
}

fn percent(value: Option<f64>) -> String {
    value.map_or_else(|| "-".into(), |value| format!("{:.1} %", value * 100.0))
}

#[cfg(test)]
mod tests {
    use super::super::plan::{Plan, QUICK};
    use super::*;
    use serde_json::json;

    fn report() -> Report {
        let plan = Plan::with(QUICK).unwrap();
        Report {
            plan: plan.settings.clone(),
            cell: plan.cells().last().unwrap().clone(),
            recorded: vec![CohortCount {
                cohort: "expert".into(),
                agent: "expert".into(),
                episodes: 4,
                steps: 120,
                successes: 4,
            }],
            separation: vec![Separation {
                cohort: "all".into(),
                episodes: 6,
                good_steps: 100,
                wrong_steps: 0,
                mean_q_good: Some(0.75),
                mean_q_wrong: None,
                auroc: None,
                interval: None,
            }],
            warnings: vec!["the scores favour cohort late".into()],
            thresholds: vec![Threshold {
                beta: 0.9,
                selected: Selected { kept: 25, of: 100, share: 0.25, precision: Some(0.5), recall: Some(0.125) },
            }],
            histogram: vec![1, 2],
            experts: vec![3, 1],
            cohorts: BTreeMap::from([("freeze".into(), vec![1, 2])]),
            policies: vec![Evaluation {
                trained_on: "experts".into(),
                result: json!({ "latency_p50_ms": 2.0, "latency_p99_ms": 4.25 }),
                success_rate: "1 of 4, 25.0 %".into(),
            }],
            stages: vec![
                Stage { stage: "record".into(), seconds: 1.5, detail: "10 episodes".into() },
                Stage { stage: "push".into(), seconds: 0.25, detail: String::new() },
            ],
            seconds: 1.75,
        }
    }

    #[test]
    fn the_table_has_the_results_and_leaves_gaps_empty() {
        let text = report().markdown();
        for row in [
            "| expert | 4 | 120 | 4 |",
            "| all | 6 | 100 | 0 | 0.750 | - | - |",
            "Warning: the scores favour cohort late.",
            "| 0.9 | 25 | 25.0 % | 50.0 % | 12.5 % |",
            "| experts | 1 of 4, 25.0 % | 2.0 ms | 4.2 ms |",
            "The same 4 episodes for each, none of them recorded; the dataset's β is 0.5, λ is 0.3, q is the share of expert steps that are at most as good.",
            "| record | 1.5 | 10 episodes |",
            "| all | 1.8 | |",
        ] {
            assert!(text.lines().any(|line| line == row), "{row} in {text}");
        }
    }

    #[test]
    fn the_json_holds_the_plan_and_the_numbers() {
        let shown = serde_json::to_value(report()).unwrap();
        assert_eq!(shown["plan"]["data"]["experts"], 4);
        assert_eq!(shown["thresholds"][0]["precision"], 0.5);
    }
}
