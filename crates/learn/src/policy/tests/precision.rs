//! Training in bf16 beside f32: the same course within a tolerance, f32 where it is measured and kept.

use gleaner_core::{OptimSpec, Precision, PretrainSpec};

use super::*;

fn reduced(optim: OptimSpec) -> OptimSpec {
    OptimSpec { precision: Precision::Bf16, ..optim }
}

/// The largest difference of losses, relative to the first, or to the loss itself where that is larger.
fn apart(exact: &Recorder, reduced: &Recorder) -> f64 {
    let first = exact.losses[0].1;
    let pairs = exact.losses.iter().zip(&reduced.losses);
    pairs.map(|((_, exact), (_, reduced))| (exact - reduced).abs() / exact.max(first)).fold(0.0, f64::max)
}

#[test]
fn pretraining_in_bf16_takes_the_course_of_f32_and_resumes_bit_for_bit() {
    let (shape, data) = (toy::shape(), toy::experts(6, 12));
    let run = |spec: &PretrainSpec, resume: Option<&[u8]>| {
        let mut monitor = Recorder::default();
        let bytes = pretrain(&shape, &data, spec, None, resume, &mut monitor).unwrap();
        (bytes, monitor)
    };
    let spec = toy::every(20, toy::pretrain_spec(40));
    let (_, exact) = run(&spec, None);
    let spec = PretrainSpec { optim: reduced(spec.optim), ..spec };
    let (bytes, course) = run(&spec, None);
    let found = apart(&exact, &course);
    assert!(found > 1e-6 && found < 0.01, "{found}");
    let (resumed, rest) = run(&spec, Some(&course.checkpoints[0].1));
    assert_eq!((bytes, &course.losses[20..]), (resumed, &rest.losses[..]));
}

#[test]
fn every_policy_trains_in_bf16_as_in_f32() {
    let (shape, experts, encoder) = (toy::shape(), toy::experts(4, 12), encoder(2));
    for kind in forms() {
        let run = |optim| {
            let mut monitor = Recorder::default();
            let spec = TrainSpec { optim, ..spec(kind, 1) };
            let encoder = if kind == "finetune" { Pretrained::encoder(&encoder) } else { Pretrained::default() };
            train_policy(&shape, encoder, &experts, &kept(0.9), &spec, None, &mut monitor).unwrap();
            monitor
        };
        let found = apart(&run(toy::optim(12)), &run(reduced(toy::optim(12))));
        // A perceptron has neither convolutions nor transformer blocks.
        assert!((found > 1e-6) == (kind != "perceptron") && found < 0.02, "{kind}: {found}");
    }
}

#[test]
fn the_loss_on_held_out_experts_is_measured_in_f32() {
    let run = |precision| {
        let optim = OptimSpec { learning_rate: 1e-12, precision, ..toy::optim(1) };
        let spec = TrainSpec { optim, validation_share: 0.5, ..spec("bc", 1) };
        let mut monitor = Recorder::default();
        train_policy(&toy::shape(), Pretrained::default(), &toy::experts(4, 12), &[], &spec, None, &mut monitor)
            .unwrap();
        (monitor.metric("loss_validation")[0], monitor.losses[0].1)
    };
    let (exact, reduced) = (run(Precision::F32), run(Precision::Bf16));
    assert!((exact.0 - reduced.0).abs() < 1e-7, "{exact:?} {reduced:?}");
    assert!((exact.1 - reduced.1).abs() > 1e-6, "{exact:?} {reduced:?}");
}
