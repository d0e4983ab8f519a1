//! The data that progress learns from, and the data it must not depend on.

use super::*;
use crate::score::Scores;
use crate::score::tests::{score_anew, spec_of};
use crate::toy;
use crate::train::Silent;

fn run(experts: &[Trajectory], imperfect: &[Trajectory], seed: u64) -> Result<Scores, LearnError> {
    let changed = [("seed", seed.into()), ("progress_steps", 8.into()), ("progress_delta", 3.into())];
    score_anew(experts, imperfect, &spec_of("progress", &changed), &mut Silent)
}

#[test]
fn gains_look_ahead_and_keep_the_last_value() {
    assert_eq!(gains(&[0.0, 0.25, 0.75, 0.5, 1.0], 2), [0.75, 0.25, 0.25, 0.5, 0.0]);
    assert_eq!(gains(&[0.25, 1.0], 9), [0.75, 0.0]);
}

/// An expert of the toy task approaches its square; played backwards it departs from it.
#[test]
fn experts_progress_and_reversed_ones_regress() {
    let experts = toy::experts(12, 10);
    let backwards = |expert: &Trajectory| {
        let reversed = |values: &[f32], width| values.chunks(width).rev().flatten().copied().collect::<Vec<f32>>();
        let backwards = expert.changed(|arrays| {
            arrays.proprioception = reversed(&arrays.proprioception, 3);
            arrays.action = reversed(&arrays.action, 2);
        });
        Trajectory { id: format!("{} reversed", expert.id), ..backwards }
    };
    let reversed: Vec<Trajectory> = experts.iter().map(backwards).collect();
    let changed = [("seed", 1.into()), ("progress_steps", 100.into()), ("progress_delta", 4.into())];
    let scores = score_anew(&experts, &reversed, &spec_of("progress", &changed), &mut Silent).unwrap();
    let mean = |episodes: &[EpisodeScores]| {
        let all: Vec<f64> = episodes.iter().flat_map(|episode| episode.w.clone()).collect();
        all.iter().sum::<f64>() / f64::from(u32::try_from(all.len()).unwrap())
    };
    let (good, bad) = (mean(&scores.experts), mean(&scores.imperfect));
    assert!(good > 0.005 && bad < -0.01, "{good} {bad}");
    assert!(scores.imperfect.iter().all(|episode| episode.match_episode.is_empty() && episode.q.len() == 10));
}

#[test]
fn an_expert_is_not_scored_by_a_network_that_saw_it() {
    let (mut experts, failure) = (toy::experts(4, 8), toy::episode("failure", 70, 9, false));
    let copy = Trajectory { id: "copy".into(), ..experts[2].clone() };
    let before = run(&experts, &[failure.clone(), copy.clone()], 3).unwrap();
    assert_eq!(before.imperfect[1].w, before.experts[2].w, "an expert under another id");
    // Another recording under the first id changes the network that scores the other fold, and does not change the one
    // that scores its own fold.
    experts[0] = toy::episode("expert 0", 999, 8, true);
    let after = run(&experts, &[failure, copy], 3).unwrap();
    assert_eq!(before.experts[2].w, after.experts[2].w);
    assert_ne!(before.experts[1].w, after.experts[1].w);
    assert_ne!(before.imperfect[0].w, after.imperfect[0].w);
}

#[test]
fn what_progress_cannot_learn_from_is_named() {
    let failure = [toy::episode("failure", 5, 9, false)];
    let message =
        |experts: &[Trajectory], imperfect: &[Trajectory]| run(experts, imperfect, 1).unwrap_err().to_string();
    let one_long = [toy::episode("a", 1, 8, true), toy::episode("b", 2, SHORTEST - 1, true)];
    for too_few in [&toy::experts(1, 8)[..], &one_long] {
        assert!(message(too_few, &failure).starts_with("experts: has too few different episodes of at least 4 steps"));
    }
    let twin = Trajectory { id: "expert 1".into(), ..failure[0].clone() };
    assert!(message(&toy::experts(3, 8), &[twin]).starts_with("episode expert 1: is an expert and imperfect"));
    let far = [failure[0].changed(|arrays| arrays.proprioception[4] = f32::MAX)];
    assert!(message(&toy::experts(3, 8), &far).starts_with("episode failure: is too far from the encoder's data"));
}

/// An expert too short for clips is scored by both networks.
#[test]
fn short_episodes_are_scored() {
    let mut experts = toy::experts(3, 8);
    experts.push(toy::episode("short", 9, SHORTEST - 1, true));
    let scores = run(&experts, &[toy::episode("one step", 5, 1, false)], 1).unwrap();
    assert_eq!((scores.experts[3].w.len(), &scores.imperfect[0].w), (SHORTEST - 1, &vec![0.0]));
}
