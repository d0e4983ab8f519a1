//! Gradients: the action to be predicted is never input, and autograd agrees with finite differences in double
//! precision.

use tch::{Kind, Tensor, no_grad_guard};

use super::*;
use crate::batch::{Batch, Segment, Segments, values};
use crate::model::{Modality, Network, View};
use crate::normalize::{Sample, Statistics};
use crate::policy::kind::PolicyInput;
use crate::policy::source::{Source, mean_loss};
use crate::pretrain::pretrain_loss;
use crate::random::{Purpose, generator};
use gleaner_core::{ActionToken, Augmentation, ModelSpec, PretrainSpec, Words as _};

// Small enough that hardly any ReLU changes sides within it.
const STEP: f64 = 1e-7;

fn network(data: &Trajectory, action_token: ActionToken) -> Network {
    let statistics = Statistics::measure(&toy::shape(), &Sample::every(&[data]), 8, Device::Cpu).unwrap();
    let spec = ModelSpec { action_token, ..toy::pretrain_spec(1).model };
    Network::new(&toy::shape(), spec, statistics, 3, Device::Cpu)
}

/// The window that ends at step 5.
fn window(data: &Trajectory) -> Batch {
    let end = Segment { trajectory: 0, step: 5, weight: 1.0 };
    Batch::collect(&toy::shape(), &[data], &[end], 4, Device::Cpu).unwrap()
}

/// Largest gradient of each step's action, `[4]`.
fn of_each_step(action: &Tensor) -> Vec<f32> {
    values(&action.grad().abs().amax([1i64].as_slice(), false))
}

fn tokens() -> impl Iterator<Item = ActionToken> {
    ActionToken::ALL.iter().map(|word| word.value)
}

#[test]
fn in_the_causal_pass_no_action_moves_its_own_prediction_or_an_earlier_one() {
    let data = toy::episode("e", 1, 6, true);
    for (token, place) in tokens().flat_map(|token| (0..4usize).map(move |place| (token, place))) {
        let network = network(&data, token);
        let batch = window(&data);
        let action = batch.action.set_requires_grad(true);
        let steps = network.steps(&network.embed_images(&batch.images), &batch.proprioception, &action);
        let prediction = network.actions(&steps, &batch.proprioception, &batch.windows, None, 4);
        prediction.select(1, i64::try_from(place).unwrap()).square().sum(None).backward();
        let moved = of_each_step(&action);
        assert!(moved[place..].iter().all(|gradient| *gradient == 0.0), "{token:?} {place}: {moved:?}");
        assert!(moved[..place].iter().all(|gradient| *gradient > 1e-7), "{token:?} {place}: {moved:?}");
    }
    let network = network(&data, ActionToken::default());
    // In the other pass the neighbours of an action take it as input.
    let batch = window(&data);
    let action = batch.action.set_requires_grad(true);
    let steps = network.steps(&network.embed_images(&batch.images), &batch.proprioception, &action);
    let features = network.features(&steps, &batch.windows, View::WHOLE, 4);
    Modality::Proprioception.of(&features).select(1, 0).square().sum(None).backward();
    assert!(of_each_step(&action).iter().all(|gradient| *gradient > 1e-7));
}

/// The largest gradient of each action of the window that ends at step 5, by which a policy's chunk moves; `None` if it
/// reads no action.
pub(super) fn moved_by_actions(policy: &dyn PolicyModel, data: &Trajectory) -> Option<Vec<f32>> {
    let end = Segment { trajectory: 0, step: 5, weight: 1.0 };
    let batch = Batch::collect(&toy::shape(), &[data], &[end], policy.info().window, Device::Cpu).unwrap();
    let action = batch.action.set_requires_grad(true);
    let input = PolicyInput {
        embedded: policy.embed_images(&batch.images),
        proprioception: batch.proprioception,
        action: action.shallow_clone(),
        windows: batch.windows,
        hidden: None,
        draws: vec![(0, 0)],
        before: 0,
    };
    policy.act(&input).square().sum(None).backward();
    action.grad().defined().then(|| of_each_step(&action))
}

#[test]
fn no_policy_looks_at_the_action_it_is_asked_for() {
    let data = toy::episode("e", 1, 6, true);
    for kind in forms() {
        let policy = untrained(kind, &[&data]);
        let moved = moved_by_actions(policy.as_ref(), &data);
        if policy.info().window == 1 {
            assert_eq!(moved, None, "{kind:?} looks at no action at all");
        } else {
            let moved = moved.unwrap();
            assert!(moved[3] == 0.0 && moved[..3].iter().all(|gradient| *gradient > 1e-7), "{kind:?}: {moved:?}");
        }
    }
}

fn to_double(parameters: &[(String, Tensor)]) {
    for (_, parameter) in parameters {
        let mut parameter = parameter.shallow_clone();
        parameter.set_data(&parameter.to_kind(Kind::Double));
    }
}

fn double(mut batch: Batch) -> Batch {
    batch.images = batch.images.iter().map(|images| images.to_kind(Kind::Double)).collect();
    batch.proprioception = batch.proprioception.to_kind(Kind::Double);
    batch.seen_proprioception = batch.proprioception.shallow_clone();
    batch.action = batch.action.to_kind(Kind::Double);
    batch
}

/// Compares autograd with central differences at the largest gradient of every parameter.
fn agree(parameters: &[(String, Tensor)], loss: &dyn Fn() -> Tensor) {
    loss().backward();
    let mut compared = 0;
    for (name, parameter) in parameters {
        let gradient = parameter.grad();
        if !gradient.defined() {
            continue;
        }
        let place = gradient.abs().argmax(None, false).int64_value(&[]);
        let exact = gradient.view(-1).double_value(&[place]);
        let at = |offset: f64| {
            let _no_grad = no_grad_guard();
            let _ = parameter.view(-1).narrow(0, place, 1).g_add_scalar_(offset);
            let value = loss().double_value(&[]);
            let _ = parameter.view(-1).narrow(0, place, 1).g_add_scalar_(-offset);
            value
        };
        let numeric = (at(STEP) - at(-STEP)) / (2.0 * STEP);
        let error = (numeric - exact).abs() / exact.abs().max(1e-3);
        assert!(error < 1e-5, "{name}: autograd {exact}, differences {numeric}");
        compared += usize::from(exact.abs() > 1e-6);
    }
    // Small networks have few parameters.
    assert!(compared > parameters.len().min(17) * 3 / 4, "only {compared} gradients are not zero");
}

#[test]
fn pretrainings_gradients_agree_with_finite_differences() {
    let data = toy::episode("e", 1, 6, true);
    let spec = PretrainSpec { augmentation: Augmentation::default(), ..toy::pretrain_spec(1) };
    let objectives = crate::objective::find(&spec.objectives).unwrap();
    for token in tokens() {
        let network = network(&data, token);
        to_double(&network.parameters());
        let loss = || {
            let total = pretrain_loss(&objectives, &network, &double(window(&data)), &spec, 0).total;
            assert_eq!(total.kind(), Kind::Double);
            total
        };
        agree(&network.parameters(), &loss);
    }
}

/// MTP and TR train the head of actions from tokens of actions, and have neither queries nor the perceptron of `image`.
#[test]
fn aa_alone_trains_the_query_and_the_perceptron_of_the_action() {
    let data = toy::episode("e", 1, 6, true);
    let tokens = [
        (ActionToken::Image, "model.head.step."),
        (ActionToken::Query, "model.token.query_"),
        (ActionToken::Fused, "model.token.query_"),
    ];
    for (token, own) in tokens {
        let trained = |names: &[&str]| -> Vec<bool> {
            let network = network(&data, token);
            let objectives: Vec<String> = names.iter().map(|name| (*name).to_owned()).collect();
            let objectives = crate::objective::find(&objectives).unwrap();
            pretrain_loss(&objectives, &network, &window(&data), &toy::pretrain_spec(1), 0).total.backward();
            let parameters = network.parameters().into_iter().filter(|(name, _)| name.starts_with(own));
            parameters.map(|(_, parameter)| parameter.grad().defined()).collect()
        };
        let (without, alone) = (trained(&["mtp", "tr"]), trained(&["aa"]));
        assert!(!without.is_empty() && without.iter().all(|trained| !trained), "{token:?}: {without:?}");
        assert!(alone.iter().all(|trained| *trained), "{token:?}: {alone:?}");
    }
}

#[test]
fn every_policys_gradients_agree_with_finite_differences() {
    let data = toy::episode("e", 1, 6, true);
    let source = Source { segments: Segments::every(&[&data]), data: vec![&data] };
    for kind in forms() {
        let policy = untrained(kind, &[&data]);
        to_double(&policy.parameters());
        let loss = || {
            let (batch, mut wanted) = source.collect(&policy.info().form(), &source.segments.all()[1..4]).unwrap();
            wanted.action = wanted.action.to_kind(Kind::Double);
            let mut noise = generator(1, Purpose::Style, 0);
            mean_loss(policy.as_ref(), double(batch), None, &wanted, &mut noise).0
        };
        assert_eq!(loss().kind(), Kind::Double);
        agree(&policy.parameters(), &loss);
    }
}
