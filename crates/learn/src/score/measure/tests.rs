//! The measure by similarity and progress, alone and in whole runs.

use super::*;
use crate::score::progress::ProgressForm;
use crate::score::tests::{encoder, score_anew, spec_of};
use crate::score::{Forgetful, LiveScorer, ScoreBase, ScoreInputs, Scores, extend_scores};
use crate::toy;
use crate::train::Silent;
use gleaner_core::ScoreSpec;

fn looking(lookahead: f64) -> Ahead {
    Ahead { lookahead, ..Ahead::default() }
}

#[test]
fn a_segment_is_as_good_as_the_best_one_that_it_leads_to() {
    let experts = toy::experts(2, 8);
    let of = |w: &[f64]| EpisodeScores { w: w.to_vec(), ..scores("a", 0, vec![0; w.len()], 0.0) };
    let alone = [of(&[-3.0, -1.0, -2.0, -4.0, -2.0, -1.0, -3.0, -5.0])];
    // L is two steps.
    let measure = Measure::new(None, (&experts, Ahead { lead_in: 0.25, ..Ahead::default() }), &alone);
    let back = of(&[-9.0, -9.0, -8.0, -1.0, -9.0, -9.0]);
    assert_eq!(
        measure.of(&back),
        [-8.0, -1.0, -1.0, -1.0, -9.0, -9.0],
        "before the way back and after it nothing changes"
    );
    assert_eq!(measure.of(&of(&[])), Vec::<f64>::new());
    // Experts are measured alike, so a half of them stays above a half.
    let led = measure.of(&alone[0]);
    assert_eq!(led, [-1.0, -1.0, -2.0, -1.0, -1.0, -1.0, -3.0, -5.0]);
    let scale = Normaliser::fit(NormaliserKind::Calibrated, led);
    // A live segment, whose later steps are unknown, is as good among experts as its similarity.
    for (w, own) in [(-1.0, 1.0), (-2.0, 0.75), (-3.0, 0.45), (-9.0, 0.0)] {
        let q = scale.q(measure.now(w, (0, 3)));
        assert!((q - own).abs() < 0.3, "{w}: {q}");
    }
    assert_eq!([-1.0, -9.0].map(|w| scale.q(measure.now(w, (0, 3)))), [1.0, 0.0]);
}

#[test]
fn an_early_segment_is_better_by_the_weight_of_earliness() {
    let experts = toy::experts(2, 4);
    let of = |w: &[f64]| EpisodeScores { w: w.to_vec(), ..scores("a", 0, vec![0; w.len()], 0.0) };
    let alone = [of(&[-1.0, -2.0, -3.0, -4.0])];
    let measure = Measure::new(None, (&experts, Ahead { earliness: 0.2, ..Ahead::default() }), &alone);
    let near = Normaliser::fit(NormaliserKind::Calibrated, alone[0].w.clone());
    let own = [-1.0, -9.0, -2.0, -2.0];
    for (at, (measured, w)) in measure.of(&of(&own)).into_iter().zip(own).enumerate() {
        let expected = 0.8 * f64::from(near.q(w)) + 0.2 * [1.0, 0.75, 0.5, 0.25][at];
        assert!((measured - expected).abs() < 1e-9, "{measured} {expected}");
    }
    assert_eq!(measure.of(&of(&[])), Vec::<f64>::new());
    // An expert's own measures stay the scale of q, also of a live segment.
    let scale = Normaliser::fit(NormaliserKind::Calibrated, measure.of(&alone[0]));
    let live = [-1.0, -2.0, -9.0].map(|w| scale.q(measure.now(w, (0, 0))));
    assert!(live[0] == 1.0 && (live[1] - near.q(-2.0)).abs() < 0.1 && live[2] == 0.0, "{live:?}");
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
    let measure = Measure::new(None, (&experts, looking(0.25)), &alone);
    let advances = measure.of(&scores("good", 0, forward, -1.0));
    let stands = measure.of(&scores("frozen", 0, vec![3; 8], -1.0));
    assert_eq!(advances, vec![1.0; 8], "to its very end");
    assert_eq!(stands[..6], [0.5; 6]);
    assert_eq!(stands[7], 1.0, "its recording ends, so nothing is known of what came next");
    // Later steps are unknown, so the similarity decides.
    assert_eq!([-1.0, -2.0].map(|w| measure.now(w, (0, 3))), [1.0, 0.0]);
    let without = Measure::new(None, (&experts, Ahead::default()), &alone);
    assert_eq!((without.of(&alone[0]), without.now(-2.0, (0, 3))), (vec![-1.0; 8], -2.0));
}

/// Experts of different lengths in another order than that of their ids, two failures, and an expert's copy.
fn episodes() -> (Vec<Trajectory>, Vec<Trajectory>) {
    let experts = [8, 14, 10, 12, 9].into_iter().zip(0..);
    let experts = experts.map(|(steps, seed)| toy::episode(&format!("expert {}", 9 - seed), seed, steps, true));
    let experts: Vec<Trajectory> = experts.collect();
    let mut frozen = experts[1].clone().changed(|arrays| {
        // The sixth step again and again.
        let (frame, widths) = (arrays.frames.len() / 14, [arrays.proprioception.len() / 14, arrays.action.len() / 14]);
        for step in 6..14 {
            arrays.frames.copy_within(5 * frame..6 * frame, step * frame);
            arrays.proprioception.copy_within(5 * widths[0]..6 * widths[0], step * widths[0]);
            arrays.action.copy_within(5 * widths[1]..6 * widths[1], step * widths[1]);
        }
    });
    frozen.id = "frozen".into();
    let copy = Trajectory { id: "copy".into(), ..experts[1].clone() };
    (experts, vec![frozen, copy, toy::episode("failure", 50, 14, false)])
}

/// In the form that needs no experts whose matches advance.
fn spec(lookahead: f64, normaliser: NormaliserKind) -> ScoreSpec {
    let furthest = ("progress", "furthest".into());
    ScoreSpec {
        normaliser,
        ..spec_of(
            "raw",
            &[("lookahead", lookahead.into()), ("lead_in", 0.0.into()), ("earliness", 0.0.into()), furthest],
        )
    }
}

fn run(spec: &ScoreSpec) -> Scores {
    let (experts, imperfect) = episodes();
    score_anew(&experts, &imperfect, spec, &mut Silent).unwrap()
}

#[test]
fn later_steps_change_q_and_neither_w_nor_matches() {
    let [with, without] = [0.5, 0.0].map(|lookahead| run(&spec(lookahead, NormaliserKind::Calibrated)));
    for (with, without) in with.imperfect.iter().zip(&without.imperfect) {
        assert_eq!((&with.w, &with.match_step), (&without.w, &without.match_step));
    }
    // Both begin with the steps of an expert; one then stands still.
    let mean = |scores: &Scores, episode: usize| scores.imperfect[episode].q[4..6].iter().sum::<f32>() / 2.0;
    assert_eq!([mean(&without, 0), mean(&without, 1)], [1.0, 1.0]);
    assert!(mean(&with, 0) < mean(&with, 1) - 0.1, "{} {}", mean(&with, 0), mean(&with, 1));
    let experts: Vec<f32> = with.experts.iter().flat_map(|expert| expert.q.clone()).collect();
    let above = experts.iter().filter(|q| **q > 0.5).count();
    assert!((experts.len() / 2).abs_diff(above) <= 3, "half of the experts' q are above a half: {above}");
}

#[test]
fn progress_is_a_share_of_the_matched_expert_s_own_episode() {
    let experts = [toy::episode("b", 1, 4, true), toy::episode("a", 2, 8, true)];
    let alone = [scores("b", 1, vec![0, 2, 4, 6], -1.0), scores("a", 0, vec![0, 0, 1, 1, 2, 2, 3, 3], -1.0)];
    for (form, of_two_steps) in [(ProgressForm::Furthest, 1.0), (ProgressForm::Pace, 0.5)] {
        let measure = Measure::new(None, (&experts, Ahead { progress: form, ..looking(0.34) }), &alone);
        let (progress, _) = measure.outlook.as_ref().unwrap().ahead.as_ref().unwrap();
        assert_eq!((progress.delta, &progress.lengths), (2, &vec![4, 8]));
        assert_eq!(progress.of(&alone[0])[..2], [0.5 * of_two_steps; 2], "four of eight steps");
        assert_eq!(progress.of(&alone[1])[0], 0.25 * of_two_steps, "one of four");
    }
}

#[test]
fn every_normaliser_applies_to_the_measure() {
    for kind in [NormaliserKind::MinMax, NormaliserKind::Quantile, NormaliserKind::Calibrated] {
        let scores = run(&spec(0.5, kind));
        let (lo, hi) = (scores.normaliser.lo, scores.normaliser.hi);
        assert!((0.0..=1.0).contains(&lo) && (0.0..=1.0).contains(&hi) && lo < hi, "{kind:?}: {lo} {hi}");
        let by_similarity = run(&spec(0.0, kind));
        assert!(by_similarity.normaliser.hi <= 0.0, "{kind:?}: similarities are not shares");
        assert_ne!(scores.imperfect[0].q, by_similarity.imperfect[0].q, "{kind:?}");
    }
}

#[test]
fn a_live_segment_is_as_good_among_experts_as_its_similarity() {
    let (experts, _) = episodes();
    let lone = run(&spec(0.0, NormaliserKind::Calibrated));
    let whole = run(&spec(0.5, NormaliserKind::Calibrated));
    // Unscaled, so that w alone decides.
    let plain = Measure::new(None, (&experts, looking(0.5)), &whole.experts);
    let near = Normaliser::fit(NormaliserKind::Calibrated, lone.experts.iter().flat_map(|e| e.w.clone()).collect());
    let both = Normaliser::fit(NormaliserKind::Calibrated, whole.experts.iter().flat_map(|e| plain.of(e)).collect());
    let mut below = 0;
    let all: Vec<f64> = lone.experts.iter().flat_map(|expert| expert.w.clone()).collect();
    for w in &all {
        let q = both.q(plain.now(*w, (0, 0)));
        assert!((q - near.q(*w)).abs() < 0.02, "{w}: {q} {}", near.q(*w));
        below += usize::from(q < 0.2);
    }
    assert!((all.len() / 5).abs_diff(below) <= 2, "a fifth of the experts: {below} of {}", all.len());
}

#[test]
fn one_expert_has_no_shares() {
    let (experts, imperfect) = episodes();
    let of = |lookahead: f64| {
        let local = ("local_scale", false.into());
        let spec = spec_of(
            "raw",
            &[("lookahead", lookahead.into()), ("lead_in", 0.0.into()), ("earliness", 0.0.into()), local],
        );
        let spec = ScoreSpec { normaliser: NormaliserKind::MinMax, ..spec };
        (score_anew(&experts[..1], &imperfect, &spec, &mut Silent).unwrap(), spec)
    };
    let (with, spec) = of(0.5);
    assert_eq!(with, of(0.0).0);
    let live = LiveScorer::load(&encoder(), &experts[..1], &spec, with.normaliser.clone()).unwrap();
    assert_eq!(live.score_episode(&imperfect[2]).unwrap(), with.imperfect[2]);
    let ids = vec![experts[0].id.clone()];
    let base = ScoreBase { normaliser: with.normaliser, experts: ids, scores: with.imperfect };
    let inputs = ScoreInputs { encoder: &encoder(), experts: &experts[..2], imperfect: &imperfect, kept: &Forgetful };
    let message = extend_scores(inputs, &base, &spec, &mut Silent).unwrap_err().to_string();
    assert!(message.starts_with("base.experts: "), "{message}");
}

#[test]
fn experts_of_different_lengths_in_any_order_are_measured_alike() {
    let (experts, imperfect) = episodes();
    let spec = spec(0.5, NormaliserKind::Calibrated);
    let whole = run(&spec);
    let live = LiveScorer::load(&encoder(), &experts, &spec, whole.normaliser.clone()).unwrap();
    for (place, episode) in imperfect.iter().enumerate().filter(|(_, episode)| episode.id != "copy") {
        assert_eq!(live.score_episode(episode).unwrap(), whole.imperfect[place]);
    }
    let reversed: Vec<Trajectory> = experts.into_iter().rev().collect();
    let other = score_anew(&reversed, &imperfect, &spec, &mut Silent).unwrap();
    for (one, other) in whole.imperfect.iter().zip(&other.imperfect) {
        assert_eq!(one.q, other.q);
    }
}

#[test]
fn the_way_back_to_what_experts_do_counts_as_good() {
    let (experts, mut imperfect) = episodes();
    // A failure that begins as none of the experts does and becomes one of them.
    let joined = imperfect[1].clone().changed(|arrays| {
        let (frame, widths) = (arrays.frames.len() / 14, [arrays.proprioception.len() / 14, arrays.action.len() / 14]);
        arrays.frames[..4 * frame].fill(0);
        arrays.proprioception[..4 * widths[0]].fill(9.0);
        arrays.action[..4 * widths[1]].fill(-9.0);
    });
    imperfect.push(Trajectory { id: "joined".into(), ..joined });
    let of = |lead_in: f64| {
        let spec = spec_of("raw", &[("lookahead", 0.0.into()), ("lead_in", lead_in.into()), ("earliness", 0.0.into())]);
        let spec = ScoreSpec { normaliser: NormaliserKind::Calibrated, ..spec };
        let scores = score_anew(&experts, &imperfect, &spec, &mut Silent).unwrap();
        let live = LiveScorer::load(&encoder(), &experts, &spec, scores.normaliser.clone()).unwrap();
        assert_eq!(live.score_episode(&imperfect[3]).unwrap(), scores.imperfect[3], "a stored run and a live one");
        scores.imperfect[3].clone()
    };
    let (without, with) = (of(0.0), of(0.2));
    assert_eq!((&with.w, &with.match_step), (&without.w, &without.match_step), "neither w nor matches change");
    // L is two steps of a mean expert's 10.6.
    let begins = |scores: &EpisodeScores| scores.q.iter().position(|q| *q > 0.5).unwrap();
    assert!(begins(&without) > 4, "a beginning unlike the experts: {:?}", without.q);
    assert_eq!(begins(&with) + 2, begins(&without), "its last steps lead to what experts do: {:?}", with.q);
    assert_eq!(with.q[..3], [0.0; 3], "and its first do not");
}
