//! A live score equals that of the run, for histories and for whole episodes.

use super::super::tests::encoder;
use super::*;
use crate::score::tests::{score_anew, spec_of, without_lookahead};
use crate::toy;
use crate::train::Silent;
use gleaner_core::{NormaliserKind, ScoreSpec, action::ActionRange, kinds::Family};

fn specs() -> Vec<ScoreSpec> {
    let plain = spec_of("ssdf", &[("feature_scale", "plain".into()), ("local_scale", false.into())]);
    let quantile = ScoreSpec { normaliser: NormaliserKind::Quantile, ..ScoreSpec::default() };
    let similarity = |word: &str| spec_of("ssdf", &[("similarity", word.into())]);
    let raw = |word: &str| spec_of("raw", &[("similarity", word.into())]);
    vec![plain, quantile, similarity("last_cosine"), similarity("segment_l2"), raw("last_l2"), raw("segment_l2")]
}

/// Experts in another order than that of their ids, and a failure.
fn episodes() -> (Vec<Trajectory>, Trajectory) {
    let mut experts = toy::experts(4, 12);
    experts.reverse();
    (experts, toy::episode("failure", 50, 14, false))
}

#[test]
fn an_episode_scores_bit_for_bit_as_in_the_run() {
    let (experts, failure) = episodes();
    for spec in specs() {
        let run = score_anew(&experts, std::slice::from_ref(&failure), &spec, &mut Silent).unwrap();
        let live = LiveScorer::load(&encoder(), &experts, &spec, run.normaliser).unwrap();
        assert_eq!(live.score_episode(&failure).unwrap(), run.imperfect[0], "{spec:?}");
    }
}

#[test]
fn an_expert_s_steps_are_compared_with_the_other_experts() {
    let (experts, failure) = episodes();
    for spec in specs() {
        let run = score_anew(&experts, std::slice::from_ref(&failure), &spec, &mut Silent).unwrap();
        let live = LiveScorer::load(&encoder(), &experts, &spec, run.normaliser).unwrap();
        for (place, expert) in experts.iter().enumerate() {
            // Known by its steps, not by its id.
            let scores = live.score_episode(&Trajectory { id: "recording".into(), ..expert.clone() }).unwrap();
            let stored = &run.experts[place];
            assert_eq!((&scores.episode_id, scores.role), (&expert.id, Role::Expert));
            assert_eq!((&scores.w, &scores.match_step), (&stored.w, &stored.match_step), "{spec:?}");
            assert_eq!(scores.match_episode, stored.match_episode);
            assert!(scores.match_episode.iter().all(|of| *of as usize != place) && scores.w.iter().all(|w| *w < 0.0));
        }
        let alone = LiveScorer::load(&encoder(), &experts[..1], &spec, live.normaliser.clone()).unwrap();
        let problem = alone.score_episode(&experts[0]).unwrap_err().to_string();
        assert!(problem.starts_with("recording: ") && problem.contains("only expert"), "{problem}");
    }
}

#[test]
fn a_session_scores_step_by_step_as_the_episode_does() {
    let (experts, failure) = episodes();
    let shape = toy::shape();
    for spec in specs().into_iter().map(without_lookahead) {
        let run = score_anew(&experts, std::slice::from_ref(&failure), &spec, &mut Silent).unwrap();
        let live = LiveScorer::load(&encoder(), &experts, &spec, run.normaliser).unwrap();
        let mut history = History::new(live.segment_length());
        let arrays = failure.arrays();
        for (step, frame) in arrays.frames.chunks(shape.frame_bytes()).enumerate() {
            let embedding = live.embed(&[frame]).unwrap().remove(0);
            history.push(embedding, arrays.proprioception[step * 3..][..3].to_vec()).unwrap();
            history.set_executed(arrays.action[step * 2..][..2].to_vec()).unwrap();
            let now = live.score(&[&history, &history]).unwrap();
            // Equal except for the place in the batch.
            assert!((now[0].w - now[1].w).abs() < 1e-5 * now[0].w.abs(), "{now:?}");
            let (w, q) = (run.imperfect[0].w[step], run.imperfect[0].q[step]);
            assert!((now[0].w - w).abs() < 1e-3 * w.abs().max(1.0), "{spec:?} {step}: {} {w}", now[0].w);
            assert!((now[0].q - q).abs() < 5e-3, "{spec:?} {step}: {} {q}", now[0].q);
        }
    }
}

#[test]
fn executed_actions_beyond_their_ranges_are_scored_as_recorded_ones() {
    let (experts, failure) = episodes();
    for scorer in ["raw", "ssdf"] {
        let spec = without_lookahead(spec_of(scorer, &[]));
        let run = score_anew(&experts, std::slice::from_ref(&failure), &spec, &mut Silent).unwrap();
        let mut live = LiveScorer::load(&encoder(), &experts, &spec, run.normaliser).unwrap();
        let ranges = [ActionRange::Within(-0.01, 0.01), ActionRange::Binary(-0.3, 0.3)];
        live.opened.network.shape.ranges = ranges.into_iter().collect();
        let recorded = live.score_episode(&failure).unwrap().w;
        assert_ne!(recorded, run.imperfect[0].w, "{scorer}: the ranges have an effect");
        let (mut history, arrays) = (History::new(live.segment_length()), failure.arrays());
        for (step, frame) in arrays.frames.chunks(toy::shape().frame_bytes()).enumerate() {
            let embedding = live.embed(&[frame]).unwrap().remove(0);
            history.push(embedding, arrays.proprioception[step * 3..][..3].to_vec()).unwrap();
            history.set_executed(arrays.action[step * 2..][..2].to_vec()).unwrap();
            let (now, w) = (live.score(&[&history]).unwrap()[0].w, recorded[step]);
            assert!((now - w).abs() < 1e-3 * w.abs().max(1.0), "{scorer} {step}: {now} {w}");
        }
    }
}

#[test]
fn a_segment_of_a_session_is_judged_without_later_steps() {
    let (experts, failure) = episodes();
    let spec = ScoreSpec::default();
    let run = score_anew(&experts, std::slice::from_ref(&failure), &spec, &mut Silent).unwrap();
    let live = LiveScorer::load(&encoder(), &experts, &spec, run.normaliser).unwrap();
    let arrays = experts[0].arrays();
    let mut history = History::new(live.segment_length());
    for step in 0..8 {
        let frames = toy::shape().frame_bytes();
        history
            .push(
                live.embed(&[&arrays.frames[step * frames..][..frames]]).unwrap().remove(0),
                arrays.proprioception[step * 3..][..3].to_vec(),
            )
            .unwrap();
        history.set_executed(arrays.action[step * 2..][..2].to_vec()).unwrap();
        let now = live.score(&[&history]).unwrap()[0];
        assert_eq!((now.match_episode, now.match_step as usize), (0, step), "an expert's own steps");
        assert_eq!((now.q, now.w.abs() < 1e-3), (1.0, true), "nothing else is known against them: {now:?}");
    }
}

#[test]
fn what_cannot_be_scored_is_named() {
    let (experts, failure) = episodes();
    let spec = ScoreSpec::default();
    let run = score_anew(&experts, &[failure], &spec, &mut Silent).unwrap();
    let load = |experts: &[Trajectory], spec: &ScoreSpec| {
        LiveScorer::load(&encoder(), experts, spec, run.normaliser.clone()).map(|_| ()).unwrap_err().to_string()
    };
    assert!(load(&[], &spec).starts_with("experts: "));
    let scorers = Family::Scorer.kinds().iter().map(|kind| spec_of(&kind.name, &[]));
    let refused: Vec<ScoreSpec> = scorers.filter(ScoreSpec::needs_all_episodes).collect();
    assert!(refused.len() >= 5, "{refused:?}");
    for spec in refused {
        assert!(load(&experts, &spec).starts_with("scorer: "), "{spec:?}");
    }
    let live = LiveScorer::load(&encoder(), &experts, &spec, run.normaliser.clone()).unwrap();
    let mut history = History::new(live.segment_length());
    assert!(live.score(&[&history]).is_err());
    history.push(live.embed(&[&toy::frame(0.1, 0.2)]).unwrap().remove(0), vec![0.0; 3]).unwrap();
    let problem = live.score(&[&history]).unwrap_err().to_string();
    assert!(problem.contains("set what was executed"), "{problem}");
    assert!(live.embed(&[&[0u8; 3][..]]).is_err());
}
