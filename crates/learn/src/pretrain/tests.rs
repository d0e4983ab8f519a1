//! Pretraining of toy episodes: resumed, stopped and damaged runs, and the loss.

mod gpu;

use std::time::Duration;

use super::*;
use crate::ahead::Assembled;
use crate::checkpoint::inspect;
use crate::toy::{self, Recorder};
use crate::train::Silent;
use gleaner_core::{Augmentation, FinishedWeights};

#[test]
fn a_resumed_run_equals_a_straight_one_bit_for_bit() {
    let (shape, data) = (toy::shape(), toy::experts(3, 12));
    let spec = toy::every(3, toy::pretrain_spec(8));
    let mut straight = Recorder::default();
    let result = pretrain(&shape, &data, &spec, None, None, &mut straight).unwrap();
    let steps: Vec<u64> = straight.checkpoints.iter().map(|(step, _)| *step).collect();
    assert_eq!(steps, [3, 6]);

    let mut resumed = Recorder::default();
    let half = &straight.checkpoints[0].1;
    let again = pretrain(&shape, &data, &spec, None, Some(half), &mut resumed).unwrap();
    assert_eq!(straight.losses[3..], resumed.losses);
    // The checkpoint of step 6 has weights and optimiser state.
    assert_eq!(straight.checkpoints[1], resumed.checkpoints[0]);
    assert_eq!(result, again);
    let finished = pretrain(&shape, &data, &spec, None, Some(&result), &mut Silent).unwrap();
    assert_eq!(result, finished);
}

#[test]
fn a_run_equals_one_whose_batches_are_assembled_when_due() {
    let (shape, data) = (toy::shape(), toy::experts(3, 12));
    let augmentation = Augmentation { shift_pixels: 2, proprioception_noise: 0.1, ..Augmentation::default() };
    let mut spec = PretrainSpec { augmentation, ..toy::pretrain_spec(4) };
    spec.optim.gradient_accumulation = 2;
    let mut ahead = Recorder::default();
    let finished = pretrain(&shape, &data, &spec, None, None, &mut ahead).unwrap();

    let data: Vec<&Trajectory> = data.iter().collect();
    let Resumed::Unfinished(training) = begin(&shape, &data, &spec, (None, None)).unwrap() else { panic!("finished") };
    let segments = Segments::every(&data);
    let standard = training.network().statistics.proprioception.shared();
    let device = tch::Device::Cpu;
    let source =
        Source { shape: &shape, data: &data, segments: &segments, spec: &spec, device, standard, part: Part::WHOLE };
    let objectives = objective::find(&spec.objectives).unwrap();
    let loss =
        |network: &Network, number| pretrain_loss(&objectives, network, &source.draw(number).unwrap(), &spec, number);
    let (mut numbers, mut due) = (0.., Recorder::default());
    let mut next = || Ok(Assembled { batch: numbers.next().unwrap(), took: Duration::ZERO });
    let run = (&mut Peers::alone(), &mut due as &mut dyn Monitor);
    let bytes = training.take_steps(9, &mut next, &loss, &|_, _| Ok(Vec::new()), run).unwrap().unwrap();
    assert_eq!((ahead.losses, finished), (due.losses, with_feature_scale(&bytes, &data, &spec).unwrap()));
}

#[test]
fn the_loss_on_episodes_that_are_held_out_is_reported_and_they_have_no_influence() {
    let shape = toy::shape();
    let spec = PretrainSpec { validation_share: 0.25, ..toy::pretrain_spec(4) };
    let train = |data: &[Trajectory]| {
        let mut monitor = Recorder::default();
        (pretrain(&shape, data, &spec, None, None, &mut monitor).unwrap(), monitor)
    };
    let data = toy::experts(4, 12);
    let (bytes, report) = train(&data);
    assert_eq!(report.metric("loss_validation").len(), 4, "{:?}", report.losses);
    // One of the four is held out; another in its place changes its loss alone.
    let (_, held_out) = validation::split(&data, (0.25, spec.run.seed), (FinishedWeights::Last, "data")).unwrap();
    let place = data.iter().position(|one| one.id == held_out[0].id).unwrap();
    let mut others = data.clone();
    others[place] = toy::episode("another", 77, 12, true);
    let (same, other) = train(&others);
    assert_eq!(same, bytes);
    assert_eq!(other.losses, report.losses);
    assert_ne!(other.metric("loss_validation"), report.metric("loss_validation"));
    // Without a share, all four are learned from.
    let whole = pretrain(&shape, &data, &toy::pretrain_spec(4), None, None, &mut Silent).unwrap();
    assert_ne!(whole, bytes);
}

#[test]
fn the_best_weights_of_a_pretraining_have_the_lowest_validation_loss_and_need_two_episodes() {
    let (shape, data) = (toy::shape(), toy::experts(4, 12));
    // At this rate the loss grows.
    let mut spec = PretrainSpec { validation_share: 0.5, ..toy::pretrain_spec(6) };
    (spec.optim.learning_rate, spec.optim.finished_weights) = (0.5, FinishedWeights::Best);
    let mut monitor = Recorder::default();
    pretrain(&shape, &data, &spec, None, None, &mut monitor).unwrap();
    let losses = monitor.metric("loss_validation");
    let lowest = losses.iter().copied().fold(f64::INFINITY, f64::min);
    assert_eq!(losses.last(), Some(&lowest), "the last metric is of the weights that are kept: {losses:?}");
    assert!(losses[..losses.len() - 1].iter().any(|loss| *loss > lowest), "{losses:?}");
    let error = pretrain(&shape, &data[..1], &spec, None, None, &mut Silent).unwrap_err().to_string();
    assert!(error.starts_with("data: has one episode, but finished_weights best"), "{error}");
}

#[test]
fn a_run_that_is_stopped_keeps_every_step() {
    let (shape, data) = (toy::shape(), toy::experts(3, 12));
    let spec = toy::every(3, toy::pretrain_spec(8));
    let straight = pretrain(&shape, &data, &spec, None, None, &mut Silent).unwrap();
    for (after, kept) in [(2, vec![2]), (3, vec![3]), (5, vec![3, 5])] {
        let mut stopped = Recorder { stop_after: Some(after), ..Recorder::default() };
        let result = pretrain(&shape, &data, &spec, None, None, &mut stopped);
        assert!(matches!(result, Err(LearnError::Cancelled)));
        assert_eq!(stopped.checkpoints.iter().map(|(step, _)| *step).collect::<Vec<_>>(), kept);
        let (_, last) = stopped.checkpoints.last().unwrap();
        assert_eq!(pretrain(&shape, &data, &spec, None, Some(last), &mut Silent).unwrap(), straight);
    }
    // Stopped again before its first step, the run has no new checkpoint to store.
    let mut first = Recorder { stop_after: Some(2), ..Recorder::default() };
    assert!(pretrain(&shape, &data, &spec, None, None, &mut first).is_err());
    let mut again = Recorder { stop_after: Some(0), ..Recorder::default() };
    assert!(pretrain(&shape, &data, &spec, None, Some(&first.checkpoints[0].1), &mut again).is_err());
    assert!(again.checkpoints.is_empty());
}

#[test]
fn a_checkpoint_of_another_run_is_refused() {
    let (shape, data) = (toy::shape(), toy::experts(2, 8));
    let spec = toy::pretrain_spec(2);
    let bytes = pretrain(&shape, &data, &spec, None, None, &mut Silent).unwrap();
    let other = {
        let mut other = spec.clone();
        other.run.seed = 99;
        other
    };
    let error = pretrain(&shape, &data, &other, None, Some(&bytes), &mut Silent).unwrap_err();
    assert!(error.to_string().starts_with("spec: "), "{error}");
}

#[test]
fn the_loss_falls_and_the_result_describes_itself() {
    let (shape, data) = (toy::shape(), toy::experts(6, 12));
    let mut monitor = Recorder::default();
    let spec = toy::pretrain_spec(120);
    let bytes = pretrain(&shape, &data, &spec, None, None, &mut monitor).unwrap();
    let mean = |part: &[(u64, f64)]| {
        part.iter().map(|(_, loss)| loss).sum::<f64>() / f64::from(u32::try_from(part.len()).unwrap())
    };
    let (first, last) = (mean(&monitor.losses[..10]), mean(&monitor.losses[110..]));
    assert!(last < 0.5 * first, "{first} {last}");
    let info = inspect(&bytes).unwrap();
    assert_eq!((info.kind, info.step, info.finished), (CheckpointKind::Encoder, 120, true));
    assert_eq!((info.shape, info.model), (shape, spec.model));
}

#[test]
fn each_objective_alone_trains() {
    let (shape, data) = (toy::shape(), toy::experts(2, 8));
    for objective in ["mtp", "tr", "aa"] {
        let spec = PretrainSpec { objectives: vec![objective.to_owned()], ..toy::pretrain_spec(2) };
        assert!(pretrain(&shape, &data, &spec, None, None, &mut Silent).is_ok());
    }
}

#[test]
fn cancelling_and_diverging_differ() {
    let (shape, data) = (toy::shape(), toy::experts(2, 8));
    let mut monitor = Recorder { stop_after: Some(2), ..Recorder::default() };
    let result = pretrain(&shape, &data, &toy::pretrain_spec(9), None, None, &mut monitor);
    assert!(matches!(result, Err(LearnError::Cancelled)));
    assert_eq!(monitor.losses.len(), 2);

    let mut spec = toy::pretrain_spec(60);
    spec.optim.learning_rate = 10.0;
    spec.optim.clip_norm = 1e12;
    spec.optim.weight_decay = 10.0;
    let result = pretrain(&shape, &data, &spec, None, None, &mut Silent);
    assert!(matches!(result, Err(LearnError::Diverged { .. })), "{result:?}");
}
