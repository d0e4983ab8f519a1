//! Score runs from encoder bytes to qualities.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use super::*;
use crate::pretrain::pretrain;
use crate::toy;
use crate::train::Silent;

fn encoder() -> Vec<u8> {
    let data = toy::experts(3, 10);
    let spec = toy::pretrain_spec(3);
    pretrain(&toy::shape(), &data, &spec, None, &mut Silent).unwrap()
}

#[test]
fn a_copy_of_an_expert_scores_best_and_the_match_is_told() {
    let experts = toy::experts(4, 12);
    let mut copy = experts[2].clone();
    copy.id = "a lucky failure".into();
    let imperfect = [toy::episode("failure", 50, 14, false), copy];
    let spec = ScoreSpec::default();
    let scores = score(&encoder(), &experts, &imperfect, &spec, &mut Silent).unwrap();
    let lucky = &scores.imperfect[1];
    assert_eq!(lucky.w, vec![0.0; 12]);
    assert_eq!(lucky.q, vec![1.0; 12]);
    assert_eq!(lucky.match_episode, vec![2; 12]);
    assert_eq!(lucky.match_step, (0..12).collect::<Vec<u32>>());
    let failure = &scores.imperfect[0];
    assert_eq!((failure.w.len(), failure.q.len()), (14, 14));
    assert!(failure.w.iter().all(|w| *w < 0.0));
    assert!(failure.q.contains(&0.0));
    assert_eq!(scores.hi, 0.0);
    for (w, distances) in failure.w.iter().zip(&failure.distances) {
        let sum: f64 = distances.iter().map(|d| f64::from(*d)).sum();
        assert!((w + sum).abs() < 1e-5);
    }
}

#[test]
fn experts_are_scored_against_the_other_experts() {
    let experts = toy::experts(3, 8);
    let imperfect = [toy::episode("failure", 50, 9, false)];
    let spec = ScoreSpec::default();
    let encoder = encoder();
    let scores = score(&encoder, &experts, &imperfect, &spec, &mut Silent).unwrap();
    assert_eq!(scores.experts.len(), 3);
    for (at, episode) in (0u32..).zip(&scores.experts) {
        assert!(episode.match_episode.iter().all(|matched| *matched != at));
        assert!(episode.q.iter().all(|q| (0.0..=1.0).contains(q)));
    }
    let alone = score(&encoder, &experts[..1], &imperfect, &spec, &mut Silent).unwrap();
    assert!(alone.experts.is_empty());
    assert_eq!(alone.imperfect[0].w.len(), 9);
}

#[test]
fn bad_input_is_named() {
    let experts = toy::experts(2, 8);
    let spec = ScoreSpec::default();
    let encoder = encoder();
    let message = |experts: &[Trajectory], imperfect: &[Trajectory]| {
        let result = score(&encoder, experts, imperfect, &spec, &mut Silent);
        result.unwrap_err().to_string()
    };
    assert!(message(&[], &experts).starts_with("experts: "));
    assert!(message(&experts, &[]).starts_with("imperfect: "));
    assert!(message(&experts[..1], &experts[..1]).contains("never matches itself"));
    let twice = [experts[0].clone(), experts[0].clone()];
    assert!(message(&twice, &experts).contains("twice"));
    let mut short = experts[1].clone();
    short.action.pop();
    assert!(message(&experts[..1], &[short]).contains("episode expert 1: action"));
}

#[test]
fn a_cancelled_run_stops() {
    let experts = toy::experts(2, 8);
    let mut monitor = toy::Recorder { stop_after: Some(1), ..Default::default() };
    let result = score(&encoder(), &experts, &experts, &ScoreSpec::default(), &mut monitor);
    assert!(matches!(result, Err(LearnError::Cancelled)));
    assert_eq!(monitor.losses.len(), 1);
}

#[test]
fn features_do_not_depend_on_what_else_is_in_the_pass() {
    let (info, named) = checkpoint::read(&encoder(), CheckpointKind::Encoder).unwrap();
    let device = tch::Device::Cpu;
    let network = Network::from_named(&info.shape, info.model, &named, device).unwrap();
    let _no_grad = no_grad_guard();
    let long = toy::episode("long", 5, 20, true);
    let width = |values: usize, each: usize| values * each;
    let short = Trajectory {
        id: "its beginning".into(),
        frames: std::sync::Arc::new(long.frames.as_ref().as_ref()[..width(11, network.shape.frame_bytes())].to_vec()),
        proprioception: long.proprioception[..width(11, 3)].to_vec(),
        action: long.action[..width(11, 2)].to_vec(),
    };
    let (long, short) = (episode_features(&network, &long), episode_features(&network, &short));
    for modality in 0..3 {
        for step in 0..11 {
            let pairs = long.row(modality, step).iter().zip(short.row(modality, step));
            for (a, b) in pairs {
                assert!((a - b).abs() < 1e-4, "{a} {b}");
            }
        }
    }
}
