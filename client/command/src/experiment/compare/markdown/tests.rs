//! The text of a comparison with every kind of gap.

use super::super::super::rate::Rate;
use super::super::super::report::PooledAuroc;
use super::super::report::{LengthBin, ScorerSeed, Separated, Success};
use super::*;

fn auroc(group: &str, mean: f64, equal_length: Option<f64>, pairs: u64) -> Auroc {
    let pooled = PooledAuroc { cohort: group.into(), mean, interval: Some((mean - 0.05, mean + 0.05)) };
    Auroc { pooled, equal_length, pairs, equal_step: equal_length.map(|_| 0.7), step_pairs: pairs / 2 }
}

fn seed(seed: u64, run: Option<&str>, success: Option<u32>, problem: Option<&str>) -> ScorerSeed {
    ScorerSeed {
        seed,
        run: run.map(str::to_owned),
        policy: success.map(|_| "pol_1".to_owned()),
        success: success.map(|successes| Rate::new(successes, 10)),
        problem: problem.map(str::to_owned),
    }
}

fn scorer(label: &str, seeds: Vec<ScorerSeed>, runs: usize) -> ScorerReport {
    let correlation = |group: &str, episodes, spearman| LengthCorrelation { group: group.into(), episodes, spearman };
    let rate = seeds.iter().find_map(|seed| seed.success);
    let scored = runs > 0;
    ScorerReport {
        label: label.into(),
        settings: gleaner_core::Values::new(),
        seeds,
        runs,
        separated: Separated {
            marked: if scored {
                vec![auroc("all", 0.9, Some(0.8), 12), auroc("noise", 0.85, None, 0)]
            } else {
                Vec::new()
            },
            outcome: None,
        },
        length: if scored {
            vec![correlation("imperfect", 4, Some(-0.5)), correlation("experts", 2, None)]
        } else {
            Vec::new()
        },
        stability: (runs > 1).then_some(0.75),
        success: Success {
            pooled: rate,
            mean_of_seeds: rate.map(|rate| rate.rate),
            precision: scored.then_some(0.5),
            recall: scored.then_some(0.25),
            ..Success::default()
        },
    }
}

/// Three scorers: one with two runs and a policy, one with one run, and one that failed.
pub(in super::super) fn comparison() -> Comparison {
    let failed = "score failed: job job_1 failed: no memory";
    let pair = |one: &str, other: &str, spearman| Agreement {
        one: one.into(),
        other: other.into(),
        spearman,
        overlap: spearman.map(|spearman: f64| spearman / 2.0),
    };
    Comparison {
        command: "gleaner compare-scorers enc_1 --top-fraction 0.2".into(),
        task: "pick_cube".into(),
        snapshot: "snap_1".into(),
        encoders: vec![Some("enc_1".into()), Some("enc_1".into())],
        experts: 2,
        imperfect: 4,
        outcomes: [("failure".to_owned(), 4)].into(),
        segments: Some(80),
        marked: 3,
        top_fraction: 0.2,
        length_bins: vec![LengthBin { from: 12, to: 20, episodes: 2 }, LengthBin { from: 30, to: 30, episodes: 2 }],
        policy: Some("bc".into()),
        simulation: Some("pick_cube".into()),
        scorers: vec![
            scorer("ssdf", vec![seed(0, Some("run_1"), Some(5), None), seed(1, Some("run_2"), Some(5), None)], 2),
            scorer("raw local_scale=false", vec![seed(0, Some("run_3"), None, Some("train failed: no memory"))], 1),
            scorer("deminf", vec![seed(0, None, None, Some(failed))], 0),
        ],
        step_alone: Some(Separated { marked: vec![auroc("all", 0.95, Some(0.6), 12)], outcome: None }),
        length_alone: Some(Separated { marked: vec![auroc("all", 0.75, Some(0.5), 12)], outcome: None }),
        agreement: vec![
            pair("ssdf", "raw local_scale=false", Some(0.5)),
            pair("ssdf", "deminf", None),
            pair("raw local_scale=false", "deminf", None),
        ],
    }
}

/// The cells of a row, without their padding.
fn row(text: &str, heading: &str, label: &str) -> Vec<String> {
    let (_, section) = text.split_once(heading).unwrap();
    let line = section.lines().find(|line| line.starts_with(&format!("| {label} "))).unwrap();
    line.trim_matches('|').split('|').map(|cell| cell.trim().to_owned()).collect()
}

#[test]
fn a_missing_value_is_replaced_by_its_reason() {
    let text = markdown(&comparison());
    let summary = |measure: &str| row(&text, "# Scorers", measure)[1..].to_vec();
    let none = "no run";
    assert_eq!(
        row(&text, "# Scorers", " "),
        ["", "ssdf", "raw local_scale=false", "deminf", "length alone", "step alone"]
    );
    assert_eq!(summary("runs"), ["2", "1", "0", "", ""]);
    let auroc = "0.900 (0.850–0.950)";
    assert_eq!(summary("AUROC of marks"), [auroc, auroc, none, "0.750 (0.700–0.800)", "0.950 (0.900–1.000)"]);
    assert_eq!(summary("marks at equal length (12 pairs)"), ["0.800", "0.800", none, "0.500", "0.600"]);
    assert_eq!(summary("marks at equal step (6 pairs)"), ["0.700", "0.700", none, "0.700", "0.700"]);
    assert!(!text.contains("outcomes at equal step"), "episodes have no step: {text}");
    assert_eq!(summary("AUROC of outcomes"), ["one outcome", "one outcome", none, "one outcome", "one outcome"]);
    assert_eq!(summary("correlation with length"), ["-0.500", "-0.500", none, "", ""]);
    assert_eq!(summary("stability"), ["0.750", "one run", none, "", ""]);
    assert_eq!(summary("best part that is good (precision), %"), ["50.0", "50.0", none, "", ""]);
    assert_eq!(summary("success, %"), ["50.0", "failed", "failed", "", ""]);
    assert_eq!(summary("95 % Wilson interval over attempts"), ["23.7–76.3", "failed", "failed", "", ""]);
    assert_eq!(summary("95 % t-interval over seeds"), ["one rate", "failed", "failed", "", ""]);
    assert_eq!(summary("successes"), ["5 of 10", "failed", "failed", "", ""]);
    assert_eq!(row(&text, "At equal length:\n", "noise"), ["noise", "no pairs", "no pairs", none, none, none, "0"]);
    assert_eq!(row(&text, "At equal step:\n", "all"), ["all", "0.700", "0.700", none, "0.700", "0.700", "6"]);
    assert_eq!(row(&text, "## Correlation with length", "experts"), ["experts", "2", "constant", "constant", none]);
    assert!(text.contains("- deminf, seed 0: score failed: job job_1 failed: no memory\n"), "{text}");
    assert!(text.contains("12–20 (2 episodes), 30 (2 episodes)"), "{text}");
}

#[test]
fn scores_that_are_all_equal_are_constant() {
    let mut found = comparison();
    (found.scorers[0].stability, found.agreement[0].spearman) = (None, None);
    let text = markdown(&found);
    assert_eq!(row(&text, "# Scorers", "stability")[1..4], ["constant", "one run", "no run"]);
    assert_eq!(row(&text, "## Agreement", "ssdf"), ["ssdf", "1", "constant", "no run"]);
}

#[test]
fn agreement_is_a_symmetric_matrix() {
    let text = markdown(&comparison());
    assert_eq!(row(&text, "## Agreement", "ssdf"), ["ssdf", "1", "0.500", "no run"]);
    assert_eq!(row(&text, "## Agreement", "raw")[1..3], ["0.500", "1"]);
    // Of a fifth each, 0.2 / 1.8 by chance.
    assert_eq!(row(&text, "(by chance 0.111)", "ssdf"), ["ssdf", "1", "0.250", "no run"]);
}

#[test]
fn comparison_without_marks_and_policies_states_so() {
    let mut found = comparison();
    (found.marked, found.policy, found.simulation) = (0, None, None);
    for scorer in &mut found.scorers {
        (scorer.separated.marked, scorer.success) = (Vec::new(), Success::default());
    }
    let text = markdown(&found);
    for (measure, gap) in [("AUROC of marks", "no marks"), ("success, %", "not trained")] {
        assert_eq!(row(&text, "# Scorers", measure)[1], gap, "{measure}");
    }
    assert!(!text.contains("Wilson"), "{text}");
    assert!(text.contains("No episode has a mark.") && !text.contains("## AUROC of marked segments"), "{text}");
    found.policy = Some("bc".into());
    assert_eq!(row(&markdown(&found), "# Scorers", "success, %")[1], "not simulated");
}
