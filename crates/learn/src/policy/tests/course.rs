//! The course of a training: what its settings of rates, accumulation and finished weights change, and that a resumed
//! run equals a straight one under each.

use gleaner_core::{FinishedWeights, OptimSpec};

use super::*;
use crate::checkpoint;

/// The result and the losses of a training of `bc` on experts alone.
fn train(optim: OptimSpec, resume: Option<&[u8]>) -> (Vec<u8>, Recorder) {
    let mut spec = TrainSpec { optim, validation_share: 0.5, ..spec("bc", 6) };
    spec.run.checkpoint_every = 2;
    let mut monitor = Recorder::default();
    let bytes =
        train_policy(&toy::shape(), Pretrained::default(), &toy::experts(4, 12), &[], &spec, resume, &mut monitor);
    (bytes.unwrap(), monitor)
}

/// The weights of a finished policy.
fn weights(bytes: &[u8]) -> Vec<f32> {
    let (_, named) = checkpoint::read(bytes, CheckpointKind::Policy).unwrap();
    let of_model = named.iter().filter(|(name, _)| name.starts_with("policy."));
    of_model.flat_map(|(_, tensor)| crate::batch::values(tensor)).collect()
}

fn finishing(finished_weights: FinishedWeights) -> OptimSpec {
    OptimSpec { finished_weights, ..toy::optim(6) }
}

#[test]
fn every_course_gives_other_weights_and_resumes_bit_for_bit() {
    let plain = train(toy::optim(6), None).0;
    for optim in [
        finishing(FinishedWeights::Ema),
        finishing(FinishedWeights::Mean),
        OptimSpec { gradient_accumulation: 3, ..toy::optim(6) },
        OptimSpec { rate_schedule: gleaner_core::RateSchedule::Constant, ..toy::optim(6) },
        OptimSpec { image_rate_factor: 0.5, ..toy::optim(6) },
        OptimSpec { precision: gleaner_core::Precision::Bf16, ..toy::optim(6) },
    ] {
        let (result, straight) = train(optim, None);
        assert_ne!(weights(&result), weights(&plain), "{optim:?}");
        let (again, resumed) = train(optim, Some(&straight.checkpoints[0].1));
        assert_eq!((result, &straight.losses[2..]), (again, &resumed.losses[..]), "{optim:?}");
    }
}

#[test]
fn the_average_lies_among_the_weights_and_leaves_the_course_as_it_is() {
    let (last, straight) = train(toy::optim(6), None);
    let (average, averaged) = train(finishing(FinishedWeights::Ema), None);
    assert_eq!(straight.losses, averaged.losses);
    let first = train(toy::optim(1), None).0;
    let (first, last, average) = (weights(&first), weights(&last), weights(&average));
    let distance = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f32>();
    assert!(distance(&average, &last) < distance(&first, &last));
}

/// At a rate at which the loss grows, the best weights are not the last.
#[test]
fn the_best_weights_have_the_lowest_validation_loss_of_the_run() {
    let wild = |finished_weights| OptimSpec { learning_rate: 0.5, finished_weights, ..toy::optim(6) };
    let (last, course) = train(wild(FinishedWeights::Last), None);
    let (best, report) = train(wild(FinishedWeights::Best), None);
    let losses = course.metric("loss_validation");
    let lowest = losses.iter().copied().fold(f64::INFINITY, f64::min);
    assert!(lowest < *losses.last().unwrap(), "{losses:?}");
    assert_ne!(weights(&best), weights(&last));
    // The last report is of the weights that the run finishes with.
    assert_eq!(report.metric("loss_validation").last().copied(), Some(lowest));
    let (again, _) = train(wild(FinishedWeights::Best), Some(&report.checkpoints.last().unwrap().1));
    assert_eq!(again, best, "resumed after the best step");
}

#[test]
fn an_accumulated_step_has_the_mean_loss_of_its_batches() {
    let one = |accumulate| OptimSpec { gradient_accumulation: accumulate, steps: 1, ..toy::optim(1) };
    // At a rate near 0, two single steps see the batches of one accumulated step.
    let frozen = OptimSpec { learning_rate: 1e-12, steps: 2, ..toy::optim(2) };
    let (_, singly) = train(frozen, None);
    let (_, together) = train(one(2), None);
    let mean = (singly.losses[0].1 + singly.losses[1].1) / 2.0;
    assert!((together.losses[0].1 - mean).abs() < 1e-6 * mean, "{} {mean}", together.losses[0].1);
}

#[test]
fn the_best_weights_of_one_expert_are_refused() {
    let spec = TrainSpec { optim: finishing(FinishedWeights::Best), validation_share: 0.5, ..spec("bc", 2) };
    let error = train_policy(&toy::shape(), Pretrained::default(), &toy::experts(1, 6), &[], &spec, None, &mut Silent)
        .unwrap_err();
    assert!(error.to_string().starts_with("experts: has one episode, but finished_weights best "), "{error}");
}
