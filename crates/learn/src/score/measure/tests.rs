//! The measure by similarity and progress, alone and in whole runs.

use super::*;
use crate::score::Scores;
use crate::score::tests::{score_anew, spec_of};
use crate::toy;
use crate::train::Silent;
use gleaner_core::ScoreSpec;

#[test]
fn a_gain_is_the_most_within_reach_and_rises_at_an_expert_s_pace_after_the_end() {
    let progress = [0.1, 0.5, 0.2, 0.2, 0.8, 0.7];
    let pace = 0.125;
    let later: Vec<f64> = (1u8..9).map(|step| 0.7 + pace * f64::from(step)).collect();
    let all = [&progress[..], &later].concat();
    let plain = |delta: usize| -> Vec<f64> {
        let reach = |at: usize| all[at + 1..].iter().take(delta).copied().fold(f64::NEG_INFINITY, f64::max);
        (0..progress.len()).map(|at| reach(at) - progress[at]).collect()
    };
    for delta in 1..8 {
        assert_eq!(gains(&progress, delta, pace), plain(delta), "{delta}");
    }
    assert_eq!(gains(&progress, 1, pace)[1], 0.2 - 0.5, "a gain may be negative");
    assert_eq!(gains(&[], 3, pace), Vec::<f64>::new());
}

#[test]
fn progress_does_not_make_up_for_an_outlier() {
    assert_eq!([blend(0.05, 1.0), blend(0.5, 0.5), blend(1.0, 0.0)], [0.525, 0.5, 0.5]);
    assert_eq!([blend(0.0, 1.0), blend(0.025, 0.975)], [0.0, 0.25]);
}

/// Scores of an episode with all matches in one expert, at these steps.
fn scores(episode: &str, expert: u32, steps: Vec<u32>, w: f64) -> EpisodeScores {
    EpisodeScores {
        episode_id: episode.into(),
        role: gleaner_core::snapshot::Role::Expert,
        w: vec![w; steps.len()],
        q: Vec::new(),
        match_episode: vec![expert; steps.len()],
        match_step: steps,
        distances: Vec::new(),
    }
}

#[test]
fn an_episode_that_stands_still_has_half_the_measure_of_one_that_advances() {
    let experts = toy::experts(2, 8);
    let forward: Vec<u32> = (0..8).collect();
    let alone = [scores("a", 1, forward.clone(), -1.0), scores("b", 0, forward.clone(), -1.0)];
    // Δ is two steps.
    let measure = Measure::new(None, (&experts, 0.25), &alone);
    let advances = measure.of(&scores("good", 0, forward, -1.0));
    let stands = measure.of(&scores("frozen", 0, vec![3; 8], -1.0));
    assert_eq!(advances, vec![1.0; 8], "to its very end");
    assert_eq!(stands[..6], [0.5; 6]);
    assert_eq!(stands[7], 1.0, "its recording ends, so nothing is known of what came next");
    // Later steps are unknown, so both are as good as their similarity.
    assert_eq!(measure.now(-1.0, (0, 3)), 1.0);
    assert_eq!(measure.now(-2.0, (0, 3)), 0.0);
    let without = Measure::new(None, (&experts, 0.0), &alone);
    assert_eq!((without.of(&alone[0]), without.now(-2.0, (0, 3))), (vec![-1.0; 8], -2.0));
}

fn run(lookahead: f64, normaliser: NormaliserKind) -> Scores {
    let experts = toy::experts(5, 12);
    let mut frozen = experts[1].clone().changed(|arrays| {
        // The sixth step again and again.
        let (frame, widths) = (arrays.frames.len() / 12, [arrays.proprioception.len() / 12, arrays.action.len() / 12]);
        for step in 6..12 {
            arrays.frames.copy_within(5 * frame..6 * frame, step * frame);
            arrays.proprioception.copy_within(5 * widths[0]..6 * widths[0], step * widths[0]);
            arrays.action.copy_within(5 * widths[1]..6 * widths[1], step * widths[1]);
        }
    });
    frozen.id = "frozen".into();
    let spec = ScoreSpec { normaliser, ..spec_of("raw", &[("lookahead", lookahead.into())]) };
    let copy = Trajectory { id: "copy".into(), ..experts[1].clone() };
    score_anew(&experts, &[frozen, copy], &spec, &mut Silent).unwrap()
}

#[test]
fn later_steps_change_q_and_neither_w_nor_matches() {
    let [with, without] = [0.5, 0.0].map(|lookahead| run(lookahead, NormaliserKind::Calibrated));
    for (with, without) in with.imperfect.iter().zip(&without.imperfect) {
        assert_eq!((&with.w, &with.match_step), (&without.w, &without.match_step));
    }
    // Both begin with the steps of an expert; one then stands still.
    let mean = |scores: &Scores, episode: usize| scores.imperfect[episode].q[2..5].iter().sum::<f32>() / 3.0;
    assert_eq!([mean(&without, 0), mean(&without, 1)], [1.0, 1.0]);
    assert!(mean(&with, 0) < mean(&with, 1) - 0.1, "{} {}", mean(&with, 0), mean(&with, 1));
    let experts: Vec<f32> = with.experts.iter().flat_map(|expert| expert.q.clone()).collect();
    let above = experts.iter().filter(|q| **q > 0.5).count();
    assert!((experts.len() / 2).abs_diff(above) <= 3, "half of the experts' q are above a half: {above}");
}

#[test]
fn every_normaliser_applies_to_the_measure() {
    let scores = run(0.5, NormaliserKind::MinMax);
    assert!((0.0..=1.0).contains(&scores.normaliser.lo) && (0.0..=1.0).contains(&scores.normaliser.hi));
    assert!(scores.imperfect.iter().any(|episode| episode.q.contains(&1.0)));
}
