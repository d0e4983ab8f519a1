//! A past that training hides is not read, which changes no loss and no gradient.

use gleaner_core::Augmentation;
use tch::Tensor;

use super::*;
use crate::batch::{Part, Segments, values};
use crate::policy::source::{Assembly, Draw, Source, mean_loss};
use crate::random::{Purpose, generator};

const PURPOSES: [Purpose; 4] = [Purpose::Batch, Purpose::Augmentation, Purpose::Style, Purpose::Dropout];

/// A policy with its history hidden in all training windows, and inputs as they are.
fn hiding(form: &str, what: &str) -> TrainSpec {
    let policy = chosen(form).with(Family::Policy, "history_dropout", 1.0).unwrap();
    let policy = policy.with(Family::Policy, "hidden_history", what).unwrap();
    TrainSpec { policy, ..toy::train_spec(1) }.with_augmentation(Augmentation::default())
}

/// The gradients that a loss gives, of all parameters.
fn gradients(policy: &dyn PolicyModel, loss: &Tensor) -> Vec<f32> {
    let parameters = policy.parameters();
    for (_, parameter) in &parameters {
        parameter.shallow_clone().zero_grad();
    }
    loss.backward();
    let of = |parameter: &Tensor| match parameter.grad() {
        gradient if gradient.defined() => values(&gradient),
        _ => vec![0.0; parameter.numel()],
    };
    parameters.iter().flat_map(|(_, parameter)| of(parameter)).collect()
}

#[test]
fn a_hidden_past_is_not_read_and_the_loss_and_its_gradients_stay() {
    let experts = toy::experts(3, 12);
    let data: Vec<&Trajectory> = experts.iter().collect();
    let shape = toy::shape();
    let source = Source { segments: Segments::every(&data), data: data.clone() };
    for (form, what) in [("tf_bc", "steps"), ("finetune", "steps"), ("tf_bc", "actions")] {
        let spec = hiding(form, what);
        let policy = untrained_with(&spec, &data);
        let assembly = Assembly::new(policy.as_ref(), &shape, &spec, Part::WHOLE).unwrap();
        let assembled = source.assemble(&assembly, &Draw { seed: 5, batch: 0, purposes: PURPOSES }).unwrap();
        let read = assembled.batch.images[0].size()[0];
        let found = assembled.loss(policy.as_ref(), Tensor::shallow_clone).total;
        let found = (found.double_value(&[]), gradients(policy.as_ref(), &found));

        let optim = &spec.optim;
        let drawn = source.segments.draw(&mut generator(5, Purpose::Batch, 0), optim.batch, optim.stretch);
        let (batch, wanted) = source.collect(&policy.info().form(), &drawn).unwrap();
        let all = batch.images[0].size()[0];
        let hidden = policy.history().hidden(&batch.windows, &vec![true; drawn.len()]);
        let (expected, _) = mean_loss(policy.as_ref(), batch, hidden, &wanted, &mut generator(5, Purpose::Style, 0));
        let expected = (expected.double_value(&[]), gradients(policy.as_ref(), &expected));

        assert!((found.0 - expected.0).abs() < 1e-6, "{form} {what}: {} {}", found.0, expected.0);
        let apart = found.1.iter().zip(&expected.1).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(apart < 1e-5 && found.1.iter().any(|value| value.abs() > 1e-3), "{form} {what}: {apart}");
        let distinct: std::collections::BTreeSet<_> = drawn.iter().map(|end| (end.trajectory, end.step)).collect();
        let newest = i64::try_from(distinct.len()).unwrap();
        assert_eq!((read == newest, all > newest), (what == "steps", true), "{form} {what}: {read} of {all} steps");
    }
}
