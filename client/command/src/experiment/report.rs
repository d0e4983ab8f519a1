//! An experiment's report: one structure, of which the Markdown, the plots and the JSON are made.

use std::collections::BTreeMap;

use gleaner_core::looks::Look;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::auroc::AurocDifference;
use super::cell::CellSettings;
use super::rate::Rate;
use super::recordings::CohortCount;
use super::standing::Progress;
use super::study::TableKind;
use crate::quality::{ALL, Selected, Separation};

/// The results of an experiment.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Report {
    pub(crate) name: String,
    pub(crate) task: String,
    /// The command that makes this report.
    pub(crate) command: String,
    pub(crate) device: String,
    /// Cores of the machine.
    pub(crate) cores: usize,
    pub(crate) progress: Progress,
    pub(crate) recorded: Vec<CohortCount>,
    pub(crate) studies: Vec<StudyReport>,
    pub(crate) stages: Vec<StageReport>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct StudyReport {
    pub(crate) name: String,
    pub(crate) table: TableKind,
    pub(crate) cells: Vec<CellReport>,
    /// Of a study of methods: one's success less another's.
    pub(crate) differences: Vec<Difference>,
    /// Of a study of scorers: the first one's AUROC less each other's.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(crate) auroc_differences: Vec<AurocDifference>,
    /// Of all its stages' jobs; those that it shares with another study count in each.
    pub(crate) machine_seconds: f64,
    pub(crate) stages: usize,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct CellReport {
    pub(crate) label: String,
    /// The settings that the study varies, with their values here.
    pub(crate) varied: Vec<(String, Value)>,
    pub(crate) settings: CellSettings,
    pub(crate) seeds: Vec<SeedReport>,
    pub(crate) pooled: Pooled,
}

/// One seed's way through a cell.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct SeedReport {
    pub(crate) seed: u64,
    /// Why it will not be complete.
    pub(crate) problem: Option<String>,
    /// Whether results are outstanding.
    pub(crate) unfinished: bool,
    pub(crate) success: Option<Rate>,
    /// The selected segments; of cells with scores.
    pub(crate) selected: Option<Selected>,
    /// Over all, then by cohort; of cells with scores.
    pub(crate) separation: Vec<Separation>,
    /// Good and bad segments by q, in equal bins over [0, 1]; of cells with scores.
    pub(crate) histogram: Vec<[u32; 2]>,
    /// Segments of experts in the same bins.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(crate) experts: Vec<u64>,
    /// Imperfect segments of each cohort in the same bins.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub(crate) cohorts: BTreeMap<String, Vec<u64>>,
    /// What its policy looks at, in the experts' episodes and (`acting`) in the attempts of its evaluation.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(crate) looks: Vec<Look>,
}

/// A cell over its seeds.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Pooled {
    /// The seeds' episodes together.
    pub(crate) success: Option<Rate>,
    /// Of the seeds' success rates.
    pub(crate) mean_of_seeds: Option<f64>,
    /// Standard deviation of the seeds' success rates; of two seeds or more.
    pub(crate) deviation_of_seeds: Option<f64>,
    /// Student's 95 % interval of their mean, within [0, 1]; of two seeds or more that differ.
    pub(crate) interval_of_seeds: Option<(f64, f64)>,
    /// The 95 % bootstrap interval of their mean over seeds and attempts; of two seeds or more.
    #[serde(default)]
    pub(crate) interval_of_levels: Option<(f64, f64)>,
    /// Means over the seeds.
    pub(crate) kept: Option<f64>,
    pub(crate) precision: Option<f64>,
    pub(crate) recall: Option<f64>,
    /// Over all, then by cohort.
    pub(crate) auroc: Vec<PooledAuroc>,
}

/// AUROC of q over a cell's seeds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct PooledAuroc {
    pub(crate) cohort: String,
    pub(crate) mean: f64,
    /// The lowest and the highest bound of the seeds' 95 % intervals.
    pub(crate) interval: Option<(f64, f64)>,
}

/// The success of one cell less that of another, over the seeds that both have.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Difference {
    /// The cells' labels.
    pub(crate) cell: String,
    pub(crate) less: String,
    pub(crate) seeds: Vec<SeedDifference>,
    /// Over the seeds.
    pub(crate) mean: f64,
    /// Student's 95 % interval of the mean.
    pub(crate) interval: Option<(f64, f64)>,
    /// The 95 % bootstrap interval over seeds and attempts; of two seeds or more.
    #[serde(default)]
    pub(crate) interval_of_levels: Option<(f64, f64)>,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct SeedDifference {
    pub(crate) seed: u64,
    /// Of the success rates, −1 to 1.
    pub(crate) difference: f64,
}

/// One stage as it stands.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct StageReport {
    pub(crate) kind: String,
    pub(crate) key: String,
    /// The first cell that needs it.
    pub(crate) label: String,
    /// Its result.
    pub(crate) id: Option<String>,
    pub(crate) job_id: Option<String>,
    pub(crate) seconds: Option<f64>,
    /// Whether it is not submitted, or its job has not ended.
    pub(crate) unfinished: bool,
    pub(crate) problem: Option<String>,
}

impl Report {
    /// With what was found put in.
    pub(crate) fn found(self, studies: Vec<StudyReport>, stages: Vec<StageReport>) -> Self {
        let cells = || studies.iter().flat_map(|study| &study.cells);
        let failed = |cell: &&CellReport| cell.seeds.iter().any(|seed| seed.problem.is_some());
        let progress = Progress {
            cells: cells().count(),
            complete: cells().filter(|cell| cell.complete_seeds() == cell.seeds.len()).count(),
            failed: cells().filter(failed).count(),
            unfinished: cells().filter(|cell| cell.seeds.iter().any(|seed| seed.unfinished)).count(),
        };
        Self { progress, studies, stages, ..self }
    }
}

impl CellReport {
    /// AUROC over all imperfect cohorts.
    pub(crate) fn auroc(&self) -> Option<&PooledAuroc> {
        self.pooled.auroc.iter().find(|auroc| auroc.cohort == ALL)
    }

    pub(crate) fn complete_seeds(&self) -> usize {
        self.seeds.iter().filter(|seed| seed.problem.is_none() && !seed.unfinished).count()
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::experiment::difference::differences;
    use crate::experiment::method::Method;
    use crate::experiment::pool::pool;
    use serde_json::json;

    pub(crate) fn seed(seed: u64, successes: Option<u32>, kept: Option<usize>) -> SeedReport {
        let separation = |cohort: &str, auroc| Separation {
            cohort: cohort.into(),
            episodes: 5,
            good_steps: 40,
            wrong_steps: 60,
            mean_q_good: Some(0.75),
            mean_q_wrong: Some(0.25),
            auroc: Some(auroc),
            interval: Some((auroc - 0.02, auroc + 0.01)),
        };
        let shift = if seed == 0 { 0.0 } else { 0.01 };
        SeedReport {
            seed,
            problem: successes.is_none().then(|| "train failed: out of memory".into()),
            unfinished: false,
            success: successes.map(|successes| Rate::new(successes, 10)),
            selected: kept.map(|kept| Selected { kept, of: 100, share: 0.3, precision: Some(0.9), recall: Some(0.5) }),
            separation: kept
                .map_or_else(Vec::new, |_| vec![separation(ALL, 0.95 + shift), separation("freeze", 0.875)]),
            histogram: kept.map_or_else(Vec::new, |kept| vec![[1, 2], [u32::try_from(kept).unwrap(), 4]]),
            experts: kept.map_or_else(Vec::new, |_| vec![1, 2]),
            cohorts: kept.into_iter().flat_map(|_| ["freeze", "noise"].map(|name| (name.into(), vec![1, 2]))).collect(),
            looks: Vec::new(),
        }
    }

    pub(crate) fn cell(label: &str, settings: CellSettings, seeds: Vec<SeedReport>) -> CellReport {
        let pooled = pool(&seeds);
        CellReport { label: label.into(), varied: vec![("method".into(), json!(label))], settings, seeds, pooled }
    }

    pub(crate) fn report() -> Report {
        let with = |method| CellSettings { method, seeds: vec![0, 1], episodes: 10, ..CellSettings::default() };
        let cells = vec![
            cell("BC", with(Method::BC), vec![seed(0, Some(2), None), seed(1, Some(4), None)]),
            cell("SSDF-base", with(Method::SSDF_BASE), vec![seed(0, Some(5), None), seed(1, Some(6), None)]),
            cell("SSDF", with(Method::SSDF), vec![seed(0, Some(8), Some(30)), seed(1, None, Some(32))]),
        ];
        let stage = |kind: &str, seconds, problem: Option<&str>| StageReport {
            kind: kind.into(),
            key: "k".into(),
            label: "Methods, BC, seed 0".into(),
            id: Some("x_1".into()),
            job_id: Some("job_1".into()),
            seconds,
            unfinished: false,
            problem: problem.map(Into::into),
        };
        let count = |cohort: &str, agent: &str, successes| CohortCount {
            cohort: cohort.into(),
            agent: agent.into(),
            episodes: 5,
            steps: 150,
            successes,
        };
        let studies = vec![StudyReport {
            name: "Methods".into(),
            table: TableKind::Methods,
            differences: differences(TableKind::Methods, &cells),
            auroc_differences: Vec::new(),
            cells,
            machine_seconds: 95.0,
            stages: 9,
        }];
        let stages = vec![
            stage("train", Some(30.5), None),
            stage("train", None, Some("out of memory")),
            stage("score", Some(4.0), None),
        ];
        let frame = Report {
            name: "tiny".into(),
            task: "pick_cube".into(),
            command: "gleaner experiment tiny.toml --out tiny".into(),
            device: "cpu".into(),
            cores: 2,
            recorded: vec![count("expert", "expert", 5), count("freeze", "freeze:1", 1)],
            progress: Progress::default(),
            studies: Vec::new(),
            stages: Vec::new(),
        };
        frame.found(studies, stages)
    }

    #[test]
    fn the_report_round_trips_through_json_and_counts_missing_seeds() {
        let text = serde_json::to_string(&report()).unwrap();
        let read: Report = serde_json::from_str(&text).unwrap();
        assert_eq!(
            (read.stages, &read.studies[0].cells[0].settings),
            (report().stages, &report().studies[0].cells[0].settings)
        );
        let shown: Value = serde_json::from_str(&text).unwrap();
        let seed = &shown["studies"][0]["cells"][2]["seeds"][0];
        assert_eq!(
            (&seed["seed"], &seed["success"]["successes"], &seed["success"]["episodes"]),
            (&json!(0), &json!(8), &json!(10))
        );
        assert!(seed["success"]["low"].as_f64() > Some(0.49) && seed["success"]["high"].as_f64() < Some(0.95));
        assert_eq!(report().progress, Progress { cells: 3, complete: 2, failed: 1, unfinished: 0 });
        assert!(!report().progress.unfinished());
    }
}
