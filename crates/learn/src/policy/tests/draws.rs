//! Policies that draw their chunks: both of two right ways to act, by the session's seed, executed before the next.

use gleaner_core::ensemble::Execution;

use super::*;

const DRAWING: [&str; 4] = ["flow", "diffusion", "flow by a transformer", "diffusion by a transformer"];

/// Episodes in which nothing is to be seen, half of them with the action 1 throughout and half with −1.
fn two_modes() -> Vec<Trajectory> {
    let episode = |(number, sign): (u64, f32)| {
        toy::episode(&format!("{number}"), 1, 8, true).changed(|arrays| {
            arrays.frames = toy::frame(0.5, 0.5).repeat(8);
            arrays.proprioception.fill(0.5);
            arrays.action.fill(sign);
        })
    };
    (0..8).map(|number| episode((number, if number % 2 == 0 { 1.0 } else { -1.0 }))).collect()
}

fn trained(kind: &str, steps: u64, execute: u64) -> Policy {
    let mut spec = spec(kind, steps);
    if DRAWING.contains(&kind) {
        spec.policy = spec.policy.with(Family::Policy, "execute_length", execute).unwrap();
    }
    let bytes =
        train_policy(&toy::shape(), Pretrained::default(), &two_modes(), &[], &spec, None, &mut Silent).unwrap();
    Policy::load(&bytes).unwrap()
}

/// The chunks of `count` new sessions with the seeds 0, 1 …
fn chunks(policy: &Policy, count: u64) -> Vec<Vec<Vec<f32>>> {
    let frame = toy::frame(0.5, 0.5);
    let steps = [Observed { frame: &frame, proprioception: &[0.5, 0.5, 0.5], executed: None }];
    let mut sessions: Vec<_> = (0..count).map(|seed| policy.session(seed)).collect();
    let mut advancing: Vec<_> = sessions.iter_mut().map(|session| (session, steps.as_slice())).collect();
    policy.advance(&mut advancing).unwrap()
}

#[test]
fn two_ways_to_act_are_both_drawn_and_never_averaged() {
    for kind in DRAWING {
        let chunks = chunks(&trained(kind, 300, 2), 400);
        let first: Vec<f32> = chunks.iter().map(|chunk| chunk[0][0]).collect();
        let near = first.iter().filter(|action| (action.abs() - 1.0).abs() < 0.2).count();
        let up = first.iter().filter(|action| **action > 0.0).count();
        assert!(near >= 360 && (140..=260).contains(&up), "{kind}: {near} near, {up} up");
        let steady = chunks.iter().filter(|chunk| chunk.iter().flatten().all(|value| value * chunk[0][0] > 0.0));
        let steady = steady.count();
        assert!(steady >= 385, "{kind}: {steady} chunks stay with their way");
    }
    let mean = chunks(&trained("bc", 100, 1), 1)[0][0][0];
    assert!(mean.abs() < 0.2, "bc predicts the mean: {mean}");
}

#[test]
fn a_session_repeats_its_draws_under_its_seed_in_any_pass() {
    for kind in DRAWING {
        let policy = trained(kind, 2, 2);
        let (few, many) = (chunks(&policy, 2), chunks(&policy, 7));
        let close =
            |a: &[Vec<f32>], b: &[Vec<f32>]| a.concat().iter().zip(b.concat()).all(|(a, b)| (a - b).abs() < 1e-5);
        assert!(few.iter().zip(&many).all(|(few, many)| close(few, many)), "{kind}");
        assert!((1..7).all(|other| !close(&many[0], &many[other])), "{kind}");
    }
}

#[test]
fn a_chunk_is_executed_before_the_next_is_drawn() {
    for kind in DRAWING {
        let policy = trained(kind, 2, 3);
        assert_eq!(policy.execution(), Execution::Horizon(3));
        let frame = toy::frame(0.5, 0.5);
        let mut session = policy.session(5);
        let step = [Observed { frame: &frame, proprioception: &[0.5, 0.5, 0.5], executed: None }];
        let mut advance = |skipped| {
            session.skip(skipped);
            policy.advance(&mut [(&mut session, &step)]).unwrap().remove(0)
        };
        let first = advance(0);
        assert_eq!((first.len(), advance(0), advance(0)), (4, first[1..].to_vec(), first[2..].to_vec()));
        let second = advance(0);
        assert!(second.len() == 4 && second != first, "{kind}");
        // Of the second chunk, one action was executed and one step passed unseen.
        assert_eq!(advance(1), second[2..]);
        assert!(advance(9).len() == 4, "{kind}: a chunk that has passed is not continued");
    }
    // A longer horizon than the chunk is the whole chunk.
    assert_eq!(trained("flow", 1, 200).execution(), Execution::Horizon(4));
}
