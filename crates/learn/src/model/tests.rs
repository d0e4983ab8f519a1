//! Dependences of a window's features: required and forbidden ones.

use super::*;
use crate::batch::{Segment, Segments, values};
use crate::normalize::Sample;
use crate::toy;
use crate::trajectory::Trajectory;
use gleaner_core::{ActionToken, Words as _};

const DEVICE: Device = Device::Cpu;

fn network(data: &[&Trajectory]) -> Network {
    let spec = toy::pretrain_spec(1).model;
    let statistics = Statistics::measure(&toy::shape(), &Sample::every(data), 8, DEVICE).unwrap();
    Network::new(&toy::shape(), spec, statistics, 3, DEVICE)
}

fn segment(step: usize) -> Segment {
    Segment { trajectory: 0, step, weight: 1.0 }
}

fn features(network: &Network, data: &Trajectory, ends: &[Segment], view: View<'_>) -> Tensor {
    let window = network.spec.window();
    let batch = Batch::collect(&network.shape, &[data], ends, window, DEVICE).unwrap();
    network.features(&network.batch_steps(&batch), &batch.windows, view, window)
}

fn largest_difference(a: &Tensor, b: &Tensor) -> f64 {
    (a - b).abs().max().double_value(&[])
}

#[test]
fn first_weights_depend_on_the_seed_alone() {
    let data = toy::episode("e", 1, 6, true);
    let weights = |seed| {
        let statistics = Statistics::measure(&toy::shape(), &Sample::every(&[&data]), 8, DEVICE).unwrap();
        let spec = toy::pretrain_spec(1).model;
        let network = Network::new(&toy::shape(), spec, statistics, seed, DEVICE);
        let all: Vec<f32> = network.parameters().iter().flat_map(|(_, p)| values(p)).collect();
        all
    };
    tch::manual_seed(1);
    let first = weights(3);
    tch::manual_seed(2);
    assert_eq!(first, weights(3));
    assert_ne!(first, weights(4));
}

#[test]
fn padding_never_leaks() {
    let data = toy::episode("e", 1, 6, true);
    let network = network(&[&data]);
    let batch = Batch::collect(&network.shape, &[&data], &[segment(1)], 4, DEVICE).unwrap();
    let steps = network.batch_steps(&batch);
    for view in [View::WHOLE, View::CAUSAL] {
        let plain = network.features(&steps, &batch.windows, view, 2);
        // Padded places now have the index of an arbitrary step.
        let nonsense = Tensor::cat(&[&steps, &(steps.narrow(0, 0, 1) * 50.0 - 7.0)], 0);
        let windows = Windows {
            index: Tensor::from_slice(&[2i64, 2, 0, 1]),
            valid: batch.windows.valid.shallow_clone(),
            valid_places: batch.windows.valid_places.clone(),
            length: 4,
        };
        let perturbed = network.features(&nonsense, &windows, view, 2);
        assert_eq!(values(&plain), values(&perturbed));
    }
}

#[test]
fn the_causal_pass_never_sees_the_action_it_predicts_nor_the_future() {
    let data = toy::episode("e", 1, 6, true);
    let network = network(&[&data]);
    // Step 3 of window 2 … 5 is its second place.
    let changed = data.changed(|arrays| arrays.action[3 * 2] += 4.0);
    let at = |data: &Trajectory, view| features(&network, data, &[segment(5)], view);
    let (plain, other) = (at(&data, View::CAUSAL), at(&changed, View::CAUSAL));
    let moved = |modality: Modality, place: i64| {
        let part = |z: &Tensor| modality.of(z).select(1, place);
        largest_difference(&part(&plain), &part(&other))
    };
    for place in [0, 1] {
        assert_eq!(moved(Modality::Image, place), 0.0);
        assert_eq!(moved(Modality::Proprioception, place), 0.0);
    }
    assert!(moved(Modality::Action, 1) > 1e-4);
    assert!(moved(Modality::Proprioception, 2) > 1e-6);
    let whole = largest_difference(
        &Modality::Proprioception.of(&at(&data, View::WHOLE)).select(1, 0),
        &Modality::Proprioception.of(&at(&changed, View::WHOLE)).select(1, 0),
    );
    assert!(whole > 1e-6, "the bidirectional pass sees everything");
}

#[test]
fn frames_encoded_once_give_what_each_window_alone_gives() {
    let data = toy::episode("e", 1, 9, true);
    let network = network(&[&data]);
    let every = Segments::every(&[&data]).all();
    let together = features(&network, &data, &every, View::WHOLE);
    for (place, end) in (0i64..).zip(every) {
        let alone = features(&network, &data, &[end], View::WHOLE);
        let valid = (end.step + 1).min(4);
        let last = |z: &Tensor| z.narrow(1, 4 - crate::batch::int(valid), crate::batch::int(valid));
        let difference = largest_difference(&last(&together.narrow(0, place, 1)), &last(&alone));
        assert!(difference < 1e-4, "{difference}");
    }
}

#[test]
fn a_hidden_element_is_not_seen() {
    let data = toy::episode("e", 1, 6, true);
    let network = network(&[&data]);
    let changed = data.changed(|arrays| arrays.proprioception[4 * 3] += 2.0);
    let mut hidden = vec![false; 12];
    hidden[2 * 3 + 1] = true;
    let hidden = Windows::grid(&hidden, &[1, 4, 3], DEVICE);
    let view = View { attention: Attention::Bidirectional, hidden: Some(&hidden) };
    let at = |data: &Trajectory, view| features(&network, data, &[segment(5)], view);
    assert_eq!(largest_difference(&at(&data, view), &at(&changed, view)), 0.0);
    assert!(largest_difference(&at(&data, View::WHOLE), &at(&changed, View::WHOLE)) > 1e-4);
}

#[test]
fn actions_of_the_newest_step_alone_are_those_of_all_steps() {
    for action_token in ActionToken::ALL.iter().map(|word| word.value) {
        let data = toy::episode("e", 1, 6, true);
        let statistics = Statistics::measure(&toy::shape(), &Sample::every(&[&data]), 8, DEVICE).unwrap();
        let spec = ModelSpec { action_token, ..toy::pretrain_spec(1).model };
        let network = Network::new(&toy::shape(), spec, statistics, 3, DEVICE);
        let batch = Batch::collect(&network.shape, &[&data], &[segment(1), segment(5)], 4, DEVICE).unwrap();
        let steps = network.batch_steps(&batch);
        let every = network.actions(&steps, &batch.proprioception, &batch.windows, None, 4);
        assert_eq!(every.size(), [2, 4, 2]);
        let newest = network.actions(&steps, &batch.proprioception, &batch.windows, None, 1);
        assert!(largest_difference(&every.narrow(1, 3, 1), &newest) < 1e-5);
    }
}

#[test]
fn a_gain_lets_keypoints_follow_the_image_from_the_beginning() {
    let data = toy::episode("e", 1, 12, true);
    let moves = |keypoint_gain: f64| {
        let statistics = Statistics::measure(&toy::shape(), &Sample::every(&[&data]), 8, DEVICE).unwrap();
        let spec = ModelSpec { keypoint_gain, ..toy::pretrain_spec(1).model };
        let network = Network::new(&toy::shape(), spec, statistics, 3, DEVICE);
        let frames = [0.1, 0.3, 0.5, 0.7, 0.9].map(|x| toy::frame(x, 1.0 - x));
        let embedded = network.embed_frames(&frames.each_ref().map(Vec::as_slice));
        embedded.std_dim([0i64].as_slice(), false, false).mean(None).double_value(&[])
    };
    let (plain, sharp) = (moves(1.0), moves(5.0));
    assert!(sharp > 2.0 * plain, "{sharp} {plain}");
}
