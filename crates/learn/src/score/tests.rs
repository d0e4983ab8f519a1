//! Score runs from encoder bytes to qualities.

use std::collections::HashMap;
use std::sync::{Mutex, OnceLock};

use super::*;
use crate::pretrain::pretrain;
use crate::toy;
use crate::train::Silent;
use gleaner_core::kinds::Family;
use gleaner_core::{NormaliserKind, Words as _};

/// A score run's settings: a scorer with some settings changed.
pub(super) fn spec_of(scorer: &str, changed: &[(&str, serde_json::Value)]) -> ScoreSpec {
    let mut values = gleaner_core::Values::new();
    values.insert("scorer".to_owned(), scorer.into());
    values.extend(changed.iter().map(|(name, value)| ((*name).to_owned(), value.clone())));
    ScoreSpec::from_values(&values).unwrap()
}

/// An encoder of the toy task.
pub(super) fn encoder() -> Vec<u8> {
    static ENCODER: OnceLock<Vec<u8>> = OnceLock::new();
    let train =
        || pretrain(&toy::shape(), &toy::experts(3, 10), &toy::pretrain_spec(3), None, None, &mut Silent).unwrap();
    ENCODER.get_or_init(train).clone()
}

/// Every combination of scorer and similarity.
fn specs() -> Vec<ScoreSpec> {
    let similarities = Similarity::ALL.iter().map(|word| word.value.as_str());
    let of = |scorer: &'static str| {
        similarities.clone().map(move |similarity| spec_of(scorer, &[("similarity", similarity.into())]))
    };
    ["ssdf", "raw"].into_iter().flat_map(of).collect()
}

/// The same comparison, with q by similarity alone.
pub(super) fn without_lookahead(mut spec: ScoreSpec) -> ScoreSpec {
    spec.scorer.settings.insert("lookahead".into(), 0.0.into());
    spec.scorer.settings.insert("lead_in".into(), 0.0.into());
    spec.scorer.settings.insert("earliness".into(), 0.0.into());
    spec
}

/// Some of the combinations, with each scorer and each kind of similarity.
fn some_specs() -> Vec<ScoreSpec> {
    specs().into_iter().step_by(3).collect()
}

/// Scores without a store of features.
pub(super) fn score_anew(
    experts: &[Trajectory],
    imperfect: &[Trajectory],
    spec: &ScoreSpec,
    monitor: &mut dyn Monitor,
) -> Result<Scores, LearnError> {
    score(ScoreInputs { encoder: &encoder(), experts, imperfect, kept: &Forgetful }, spec, monitor)
}

/// Settings for a single expert, which is not compared with others.
pub(super) fn minmax() -> ScoreSpec {
    ScoreSpec { normaliser: NormaliserKind::MinMax, ..ScoreSpec::default() }
}

fn run(experts: &[Trajectory], imperfect: &[Trajectory], spec: &ScoreSpec) -> Scores {
    score_anew(experts, imperfect, spec, &mut Silent).unwrap()
}

#[test]
fn the_seed_alone_decides_whatever_the_order_of_episodes() {
    for kind in Family::Scorer.kinds() {
        let has = |name: &str| kind.settings.iter().any(|setting| setting.name == name);
        let scores = |experts: &[Trajectory], imperfect: &[Trajectory], seed: u64| {
            let wanted = [("seed", seed), ("progress_steps", 8), ("neighbours", 16)];
            let changed = wanted.into_iter().filter(|(name, _)| has(name)).map(|(name, value)| (name, value.into()));
            run(experts, imperfect, &spec_of(&kind.name, &changed.collect::<Vec<_>>()))
        };
        let (mut experts, mut imperfect) =
            (toy::experts(4, 8), vec![toy::episode("f", 70, 9, false), toy::episode("g", 71, 5, false)]);
        let first = scores(&experts, &imperfect, 7);
        experts.reverse();
        imperfect.reverse();
        let mut again = scores(&experts, &imperfect, 7);
        again.experts.reverse();
        again.imperfect.reverse();
        // Matches are indices into the given experts.
        let all = |scores: &Scores| -> Vec<(String, Vec<f64>, Vec<f32>)> {
            let episodes = scores.imperfect.iter().chain(&scores.experts);
            episodes.map(|episode| (episode.episode_id.clone(), episode.w.clone(), episode.q.clone())).collect()
        };
        assert_eq!((all(&first), &first.normaliser), (all(&again), &again.normaliser), "{}", kind.name);
        let other = scores(&experts, &imperfect, 8);
        // DemInf draws the batches of more steps than these.
        if has("seed") && kind.name != "deminf" {
            assert_ne!(again.imperfect[0].w, other.imperfect[1].w, "{}", kind.name);
            assert_ne!(again.experts[0].w, other.experts[3].w, "{}", kind.name);
        }
    }
}

#[test]
fn a_copy_of_an_expert_scores_best_and_has_its_match() {
    let experts = toy::experts(4, 12);
    let mut copy = experts[2].clone();
    copy.id = "a lucky failure".into();
    let imperfect = [toy::episode("failure", 50, 14, false), copy];
    for normaliser in [NormaliserKind::MinMax, NormaliserKind::Quantile] {
        for spec in specs() {
            let spec = ScoreSpec { normaliser, ..without_lookahead(spec) };
            let scores = run(&experts, &imperfect, &spec);
            let lucky = &scores.imperfect[1];
            assert_eq!(lucky.w, vec![0.0; 12], "{spec:?}");
            assert!(lucky.w.iter().all(|w| w.is_sign_positive()));
            assert_eq!(lucky.q, vec![1.0; 12]);
            if spec.scorer.name == "ssdf" {
                assert_eq!(lucky.match_episode, vec![2; 12]);
                assert_eq!(lucky.match_step, (0..12).collect::<Vec<u32>>());
            }
            let failure = &scores.imperfect[0];
            assert_eq!((failure.w.len(), failure.q.len()), (14, 14));
            assert!(failure.w.iter().all(|w| *w < 0.0));
            assert!(failure.q.contains(&0.0));
            assert_eq!((scores.normaliser.kind, scores.normaliser.hi), (normaliser, 0.0));
            for (w, distances) in failure.w.iter().zip(&failure.distances) {
                let sum: f64 = distances.iter().map(|d| f64::from(*d)).sum();
                assert!((w + sum).abs() < 1e-5);
            }
        }
    }
}

#[test]
fn a_calibrated_run_gives_experts_a_uniform_quality_and_copies_the_highest() {
    let experts = toy::experts(4, 12);
    let mut copy = experts[2].clone();
    copy.id = "a lucky failure".into();
    for spec in specs() {
        let spec = ScoreSpec { normaliser: NormaliserKind::Calibrated, ..without_lookahead(spec) };
        let scores = run(&experts, &[toy::episode("failure", 50, 14, false), copy.clone()], &spec);
        expect_uniform(&scores, 0.1);
        assert_eq!(scores.imperfect[1].q, vec![1.0; 12], "{spec:?}");
    }
    let spec = ScoreSpec { normaliser: NormaliserKind::Calibrated, ..ScoreSpec::default() };
    let alone = score_anew(&experts[..1], &[copy], &spec, &mut Silent).unwrap_err().to_string();
    assert!(alone.starts_with("experts: has one episode, but calibrated "), "{alone}");
}

/// Fails if the q of the experts, in order, differs from that of a uniform distribution by this much anywhere.
fn expect_uniform(scores: &Scores, most: f32) {
    let mut q: Vec<f32> = scores.experts.iter().flat_map(|episode| episode.q.clone()).collect();
    q.sort_by(f32::total_cmp);
    let last = (q.len() - 1) as f32;
    assert!(q.iter().enumerate().all(|(place, q)| (q - place as f32 / last).abs() < most), "{q:?}");
}

/// With progress, a lead-in and earliness too, which join neighbouring segments.
#[test]
fn experts_have_a_uniform_quality_by_the_default_scores() {
    let spec = ScoreSpec::default();
    assert_eq!(spec.scorer.name, "raw");
    let scores = run(&toy::experts(8, 24), &[toy::episode("failure", 50, 14, false)], &spec);
    expect_uniform(&scores, 0.1);
}

#[test]
fn experts_are_scored_against_the_other_experts() {
    let experts = toy::experts(3, 8);
    let imperfect = [toy::episode("failure", 50, 9, false)];
    let scores = run(&experts, &imperfect, &ScoreSpec::default());
    assert_eq!(scores.experts.len(), 3);
    for (at, episode) in (0u32..).zip(&scores.experts) {
        assert_eq!(episode.episode_id, experts[at as usize].id);
        assert!(episode.match_episode.iter().all(|matched| *matched != at));
        assert!(episode.q.iter().all(|q| (0.0..=1.0).contains(q)));
    }
    let alone = run(&experts[..1], &imperfect, &minmax());
    assert!(alone.experts.is_empty());
    assert_eq!(alone.imperfect[0].w.len(), 9);
}

#[test]
fn the_order_of_the_episodes_does_not_matter() {
    let mut experts = toy::experts(4, 9);
    // The same steps under two ids: a tie goes to the id that sorts first.
    experts[3] = Trajectory { id: experts[3].id.clone(), ..experts[0].clone() };
    let mut imperfect: Vec<Trajectory> = (0..3).map(|i| toy::episode(&format!("f{i}"), 60 + i, 7, i == 1)).collect();
    let mut same = experts[0].clone();
    same.id = "f9".into();
    imperfect.push(same);
    for spec in some_specs() {
        let mut straight = run(&experts, &imperfect, &spec);
        assert_eq!(straight.imperfect[3].match_episode, vec![0; 9], "{spec:?}");
        let reversed = |all: &[Trajectory]| all.iter().rev().cloned().collect::<Vec<_>>();
        let mut other = run(&reversed(&experts), &reversed(&imperfect), &spec);
        other.experts.reverse();
        other.imperfect.reverse();
        for episode in other.experts.iter_mut().chain(&mut other.imperfect) {
            episode.match_episode.iter_mut().for_each(|at| *at = 3 - *at);
        }
        assert_eq!(straight, other);
        straight.experts.clear();
        assert_ne!(straight, other);
    }
}

#[test]
fn bad_input_is_named() {
    let experts = toy::experts(2, 8);
    let message = |experts: &[Trajectory], imperfect: &[Trajectory]| {
        let result = score_anew(experts, imperfect, &minmax(), &mut Silent);
        result.unwrap_err().to_string()
    };
    assert!(message(&[], &experts).starts_with("experts: "));
    assert!(message(&experts, &[]).starts_with("imperfect: "));
    assert!(message(&experts[..1], &experts[..1]).contains("never matches itself"));
    let twice = [experts[0].clone(), experts[0].clone()];
    assert!(message(&twice, &experts).contains("twice"));
    assert!(message(&experts, &twice).starts_with("imperfect: "));
    let short = experts[1].changed(|arrays| arrays.widths.action = 1);
    assert!(message(&experts[..1], &[short]).contains("episode expert 1: action"));
}

#[test]
fn a_cancelled_run_stops() {
    let experts = toy::experts(2, 8);
    for scorer in ["ssdf", "classifier", "deminf", "progress", "vote"] {
        let mut monitor = toy::Recorder { stop_after: Some(1), ..Default::default() };
        let spec = spec_of(scorer, &[]);
        let result = score_anew(&experts, &experts, &spec, &mut monitor);
        assert!(matches!(result, Err(LearnError::Cancelled)));
        assert_eq!(monitor.losses.len(), 1);
    }
}

/// Stores features in memory.
#[derive(Default)]
pub(super) struct Shared(pub(super) Mutex<HashMap<String, Vec<u8>>>);

impl FeatureStore for Shared {
    fn get(&self, episode: &str) -> Option<Vec<u8>> {
        self.0.lock().unwrap().get(episode).cloned()
    }

    fn put(&self, episode: &str, bytes: &[u8]) {
        self.0.lock().unwrap().insert(episode.to_owned(), bytes.to_vec());
    }
}

/// Tests of runs with several experts of one recording.
mod copies;
/// Tests of runs that extend an earlier one.
mod extend;
/// Tests of runs on a GPU.
mod gpu;
/// Tests of runs that several ranks share.
mod shards;
