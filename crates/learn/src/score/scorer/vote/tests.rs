//! What the vote separates, and the data it must not depend on.

use super::*;
use crate::pretrain;
use crate::score::tests::{encoder, spec_of};
use crate::score::{Forgetful, ScoreInputs, Scores, score};
use crate::toy;
use crate::train::Silent;

fn run(experts: &[Trajectory], imperfect: &[Trajectory], seed: u64) -> Result<Scores, LearnError> {
    run_with(&encoder(), experts, imperfect, seed)
}

fn run_with(encoder: &[u8], experts: &[Trajectory], imperfect: &[Trajectory], seed: u64) -> Result<Scores, LearnError> {
    let changed = [("seed", seed.into()), ("neighbours", 16.into())];
    let inputs = ScoreInputs { encoder, experts, imperfect, kept: &Forgetful };
    score(inputs, &spec_of("vote", &changed), &mut Silent)
}

fn mean(episodes: &[EpisodeScores]) -> f64 {
    let all: Vec<f64> = episodes.iter().flat_map(|episode| episode.w.clone()).collect();
    all.iter().sum::<f64>() / f64::from(u32::try_from(all.len()).unwrap())
}

#[test]
fn experts_have_more_votes_than_failures() {
    let experts = toy::experts(12, 10);
    let failures: Vec<Trajectory> = (50..54).map(|seed| toy::episode(&format!("f {seed}"), seed, 10, false)).collect();
    let encoder = pretrain(&toy::shape(), &experts, &toy::pretrain_spec(60), None, None, &mut Silent).unwrap();
    // One draw of corruptions is not enough: of eleven, one put the failures above.
    let runs: Vec<Scores> = (1..5).map(|seed| run_with(&encoder, &experts, &failures, seed).unwrap()).collect();
    let over = |of: fn(&Scores) -> &[EpisodeScores]| runs.iter().map(|scores| mean(of(scores))).sum::<f64>() / 4.0;
    let (good, bad) = (over(|scores| &scores.experts), over(|scores| &scores.imperfect));
    assert!(good > bad + 0.05, "{good} {bad}");
    let scores = &runs[0];
    for episode in scores.experts.iter().chain(&scores.imperfect) {
        assert!(episode.w.iter().all(|w| (0.0..=1.0).contains(w)) && episode.match_episode.is_empty());
        assert_eq!((episode.w.len(), episode.q.len()), (10, 10));
    }
}

/// A copy with one action changed a little is another recording, so its original votes for it.
#[test]
fn an_episode_has_no_vote_on_itself_under_any_id() {
    let mut experts = toy::experts(4, 8);
    experts.push(Trajectory { id: "a copy".into(), ..experts[1].clone() });
    let copy = Trajectory { id: "another copy".into(), ..experts[1].clone() };
    let changed = Trajectory { id: "changed".into(), ..copy.changed(|arrays| arrays.action[0] += 1e-4) };
    let scores = run(&experts, &[copy, changed], 1).unwrap();
    assert_eq!(scores.imperfect[0].w, scores.experts[1].w);
    assert_eq!(scores.experts[4].w, scores.experts[1].w);
    let [alone, with_vote] = [0, 1].map(|at: usize| mean(&scores.imperfect[at..=at]));
    assert!(with_vote > alone + 0.03, "{alone} {with_vote}");
}

#[test]
fn what_has_no_vote_is_named() {
    let failure = [toy::episode("failure", 5, 9, false)];
    let message =
        |experts: &[Trajectory], imperfect: &[Trajectory]| run(experts, imperfect, 1).unwrap_err().to_string();
    let same = [toy::experts(1, 8)[0].clone(), Trajectory { id: "again".into(), ..toy::experts(1, 8)[0].clone() }];
    for too_few in [&same[..1], &same] {
        assert!(message(too_few, &failure).starts_with("experts: has too few different episodes for vote"));
    }
    let twin = Trajectory { id: "expert 1".into(), ..failure[0].clone() };
    assert!(message(&toy::experts(3, 8), &[twin]).starts_with("episode expert 1: is an expert and imperfect"));
    let far = [failure[0].changed(|arrays| arrays.proprioception[4] = f32::MAX)];
    assert!(message(&toy::experts(3, 8), &far).contains("features of episode failure that are not finite"));
}
