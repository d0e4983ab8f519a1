//! Trainings of two and three ranks, each on a thread of its own, beside the same training in one process.

mod gpu;

use std::sync::Mutex;
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::Duration;

use gleaner_core::kinds::Family;
use gleaner_core::{Augmentation, Chosen, PretrainSpec, TrainSpec};
use tch::Tensor;

use super::testing::{ranks, ranks_within};
use crate::checkpoint;
use crate::checkpoint::CheckpointKind;
use crate::error::LearnError;
use crate::own_process::in_own_process;
use crate::policy::{Pretrained, train_policy, train_policy_with};
use crate::pretrain::{pretrain, pretrain_with};
use crate::toy::{self, Recorder};
use crate::train::{Participant, Silent};
use crate::trajectory::WeightedSegments;

type Made = Result<Option<Vec<u8>>, LearnError>;

/// The result and the reports of rank 0, after checks on those of the others.
fn of_rank_0(mut all: Vec<(Made, Recorder)>) -> (Vec<u8>, Recorder) {
    for (made, monitor) in all.drain(1..) {
        assert!(made.unwrap().is_none() && monitor.losses.is_empty() && monitor.checkpoints.is_empty());
    }
    let (made, monitor) = all.remove(0);
    (made.unwrap().unwrap(), monitor)
}

/// Every metric of a step that does not measure time, in both runs.
fn assert_same_metrics(alone: &Recorder, shared: &Recorder, tolerance: f64) {
    assert_eq!(alone.metrics.len(), shared.metrics.len());
    let of_time = ["ms_per_step", "ms_per_batch", "waited_share"];
    for (step, (one, other)) in alone.metrics.iter().zip(&shared.metrics).enumerate() {
        for (name, value) in one.iter().filter(|(name, _)| !of_time.contains(name)) {
            let difference = (value - other[name]).abs() / value.abs().max(1e-3);
            assert!(
                difference < tolerance,
                "step {step}: {name} is {value} in one process and {} in several",
                other[name]
            );
        }
        assert!((0.0..=1.0).contains(&other["summing_share"]));
    }
}

fn pretrain_spec() -> PretrainSpec {
    let augmentation = Augmentation {
        shift_pixels: 2,
        brightness: 0.1,
        proprioception_noise: 0.1,
        proprioception_dropout: 0.1,
        ..Augmentation::default()
    };
    let mut spec = PretrainSpec { augmentation, ..toy::every(3, toy::pretrain_spec(7)) };
    // Not a multiple of the ranks, nor of the stretch.
    spec.optim.batch = 13;
    spec.optim.gradient_accumulation = 2;
    spec
}

fn pretrained_by(count: usize, spec: &PretrainSpec, resume: Option<&[u8]>) -> (Vec<u8>, Recorder) {
    // Short episodes: padding differs between the ranks.
    let (shape, data) = (toy::shape(), toy::experts(4, 5));
    of_rank_0(ranks(&vec![None; count], |peers, monitor| {
        pretrain_with(&shape, &data, spec, None, Participant { resume, peers, monitor })
    }))
}

#[test]
fn ranks_pretrain_as_one_process_does_and_repeat_bit_for_bit() {
    if !in_own_process() {
        return;
    }
    let spec = pretrain_spec();
    let mut alone = Recorder::default();
    pretrain(&toy::shape(), &toy::experts(4, 5), &spec, None, None, &mut alone).unwrap();
    for count in [2, 3] {
        let (bytes, shared) = pretrained_by(count, &spec, None);
        assert_same_metrics(&alone, &shared, 1e-3);
        let (again, repeated) = pretrained_by(count, &spec, None);
        assert!(bytes == again, "{count} ranks gave other bytes in another run");
        assert_eq!((shared.losses, shared.checkpoints), (repeated.losses, repeated.checkpoints));
    }
}

#[test]
fn another_number_of_ranks_resumes_from_a_checkpoint() {
    if !in_own_process() {
        return;
    }
    let spec = pretrain_spec();
    let (bytes, straight) = pretrained_by(2, &spec, None);
    let half = &straight.checkpoints[0];
    assert_eq!(half.0, 3);
    let (resumed, rest) = pretrained_by(2, &spec, Some(&half.1));
    assert!(bytes == resumed, "a resumed run differs");
    assert_eq!(rest.losses, straight.losses[3..]);
    for count in [1, 3] {
        let (other, rest) = pretrained_by(count, &spec, Some(&half.1));
        for ((_, one), (_, other)) in straight.losses[3..].iter().zip(&rest.losses) {
            assert!((one - other).abs() / one < 1e-3, "{count} ranks: {one} and {other}");
        }
        let weights = |bytes: &[u8]| checkpoint::read(bytes, CheckpointKind::Encoder).unwrap().1;
        // The scale of features is a matrix of whitening, whose axes a rounding can exchange.
        for (name, one) in weights(&bytes).into_iter().filter(|(name, _)| name.starts_with("model.")) {
            let difference = (one - &weights(&other)[&name]).abs().max().double_value(&[]);
            assert!(difference < 1e-2, "{name} differs by {difference} with {count} ranks");
        }
    }
}

fn kept() -> Vec<WeightedSegments> {
    let segments = |seed: u64| WeightedSegments {
        trajectory: toy::episode(&format!("imperfect {seed}"), 100 + seed, 9, false),
        steps: (0..9).map(|step| (step, 0.1 * step as f32)).collect(),
    };
    (0..2).map(segments).collect()
}

fn train_spec(policy: &str) -> TrainSpec {
    let augmentation = Augmentation { shift_pixels: 1, proprioception_noise: 0.1, ..Augmentation::default() };
    let policy = Chosen::new(Family::Policy, policy).unwrap();
    let mut spec = TrainSpec { policy, dropout: 0.2, ..toy::train_spec(3) }.with_augmentation(augmentation);
    spec.optim.batch = 7;
    spec
}

#[test]
fn ranks_train_every_policy_as_one_process_does_and_repeat_bit_for_bit() {
    if !in_own_process() {
        return;
    }
    let (shape, experts, kept) = (toy::shape(), toy::experts(3, 8), kept());
    let encoder = pretrain(&shape, &experts, &toy::pretrain_spec(2), None, None, &mut Silent).unwrap();
    for kind in crate::policy::describe() {
        let spec = train_spec(&kind.name);
        let pretrained = if kind.needs.encoder { Pretrained::encoder(&encoder) } else { Pretrained::default() };
        let mut alone = Recorder::default();
        train_policy(&shape, pretrained, &experts, &kept, &spec, None, &mut alone).unwrap();
        let run = || {
            of_rank_0(ranks(&[None; 2], |peers, monitor| {
                let participant = Participant { resume: None, peers, monitor };
                train_policy_with(&shape, pretrained, &experts, &kept, &spec, participant)
            }))
        };
        let (bytes, shared) = run();
        assert_same_metrics(&alone, &shared, 5e-3);
        assert!(bytes == run().0, "{} gave other bytes in another run", kind.name);
    }
}

#[test]
fn a_rank_that_is_asked_to_stop_takes_all_along_with_a_checkpoint() {
    if !in_own_process() {
        return;
    }
    let (shape, data, spec) = (toy::shape(), toy::experts(3, 8), toy::every(100, toy::pretrain_spec(9)));
    let done = ranks(&[Some(4), None], |peers, monitor| {
        pretrain_with(&shape, &data, &spec, None, Participant { resume: None, peers, monitor })
    });
    assert!(done.iter().all(|(made, _)| matches!(made, Err(LearnError::Cancelled))));
    // Asked after four steps, the ranks agree in the fifth.
    assert_eq!(done[0].1.checkpoints.iter().map(|(step, _)| *step).collect::<Vec<_>>(), [5]);
    let follower = ranks(&[None, Some(0)], |peers, monitor| {
        pretrain_with(&shape, &data, &spec, None, Participant { resume: None, peers, monitor })
    });
    assert!(follower.iter().all(|(made, _)| matches!(made, Err(LearnError::Cancelled))));
    assert_eq!(follower[0].1.losses.len(), 1);
}

/// As on a disk that is full for a while.
#[test]
fn ranks_wait_for_what_the_lead_does_alone_and_not_for_a_silent_one() {
    if !in_own_process() {
        return;
    }
    let patience = Duration::from_secs(4);
    let (_open, never) = channel::<()>();
    let never = Mutex::new(never);
    let storing = || never.lock().unwrap().recv_timeout(patience * 2).unwrap_err();
    let done = ranks_within(patience, &[None; 3], |peers, _| {
        let parameters = [Tensor::from(1.0)];
        let stored = peers.lead_alone(parameters.iter(), storing)?;
        peers.align(5, parameters.iter())?;
        Ok::<_, LearnError>(stored)
    });
    let stored: Vec<_> = done.into_iter().map(|(stored, _)| stored.unwrap()).collect();
    assert_eq!(stored, [Some(RecvTimeoutError::Timeout), None, None]);
    let silent = ranks_within(patience, &[None; 2], |peers, _| {
        if peers.lead() {
            storing();
        }
        peers.align(5, [Tensor::from(1.0)].iter())
    });
    assert!(silent.iter().all(|(aligned, _)| matches!(aligned, Err(LearnError::Group(_)))));
}

#[test]
fn a_lost_rank_and_too_small_a_batch_are_errors_of_the_others() {
    if !in_own_process() {
        return;
    }
    let (shape, data, spec) = (toy::shape(), toy::experts(3, 8), toy::pretrain_spec(9));
    let done = ranks(&[None, None], |peers, monitor| {
        if !peers.lead() {
            // Its group ends with it.
            return Ok(None);
        }
        pretrain_with(&shape, &data, &spec, None, Participant { resume: None, peers, monitor })
    });
    assert!(matches!(&done[0].0, Err(LearnError::Group(_))), "{:?}", done[0].0);
    let mut small = spec.clone();
    small.optim.batch = 1;
    let done = ranks(&[None, None], |peers, monitor| {
        pretrain_with(&shape, &data, &small, None, Participant { resume: None, peers, monitor })
    });
    for (made, _) in done {
        let error = made.unwrap_err().to_string();
        assert!(error.starts_with("batch: is 1, fewer segments than the 2 ranks"), "{error}");
    }
}
