//! Training and running policies.

mod chunks;
mod course;
mod draws;
mod dropout;
mod every_kind;
mod finetune;
mod gpu;
mod gradients;
mod hiding;
mod identity;
mod image_weights;
mod precision;
mod switches;

use tch::Device;

use super::find;
use super::kind::{PolicyInit, PolicyModel};
use super::{Observed, Policy, Pretrained, train_policy};
use crate::History;
use crate::checkpoint::{CheckpointInfo, CheckpointKind, FORMAT_VERSION};
use crate::error::LearnError;
use crate::normalize::Sample;
use crate::pretrain::pretrain;
use crate::toy::{self, Recorder};
use crate::train::Silent;
use crate::trajectory::{Trajectory, WeightedSegments};
use gleaner_core::kinds::{Family, Kind};
use gleaner_core::{Chosen, TrainSpec};

/// ACT with a grid of image tokens.
const GRID: &str = "act, grid";

/// A form of a policy that other values of its settings select: a name, the policy and the settings.
type Form = (&'static str, &'static str, &'static [(&'static str, &'static str)]);

/// The forms beside the policies with their defaults.
const OTHERS: [Form; 4] = [
    (GRID, "act", &[("image_tokens", "grid"), ("chunk_network", "transformer"), ("chunk_execution", "ensembled")]),
    ("act by a transformer", "act", &[("chunk_network", "transformer"), ("chunk_execution", "ensembled")]),
    ("flow by a transformer", "flow", &[("chunk_network", "transformer"), ("prediction", "noise")]),
    ("diffusion by a transformer", "diffusion", &[("chunk_network", "transformer"), ("prediction", "noise")]),
];

/// The forms of all policies: their names, and [`OTHERS`].
pub(super) fn forms() -> impl Iterator<Item = &'static str> {
    Family::Policy.kinds().iter().map(|kind| kind.name.as_str()).chain(OTHERS.map(|(form, ..)| form))
}

/// The policy of a form.
pub(super) fn kind_of(form: &str) -> &'static Kind {
    let other = OTHERS.iter().find(|(other, ..)| *other == form);
    Family::Policy.find(other.map_or(form, |(_, kind, _)| kind)).unwrap()
}

/// A policy with small settings.
fn chosen(form: &str) -> Chosen {
    let small = |chosen: Chosen, name: &str, value: u32| match chosen.settings.contains_key(name) {
        true => chosen.with(Family::Policy, name, value).unwrap(),
        false => chosen,
    };
    let smaller = [("segment_length", 3), ("chunk_length", 4), ("latent_size", 4)];
    let chosen = Chosen::new(Family::Policy, &kind_of(form).name).unwrap();
    let words = OTHERS.iter().filter(|(other, ..)| *other == form).flat_map(|(.., words)| words.iter());
    let chosen = words.fold(chosen, |chosen, (name, word)| chosen.with(Family::Policy, name, *word).unwrap());
    smaller.into_iter().fold(chosen, |chosen, (name, value)| small(chosen, name, value))
}

fn encoder(steps: u64) -> Vec<u8> {
    let data = toy::experts(4, 12);
    let spec = toy::pretrain_spec(steps);
    pretrain(&toy::shape(), &data, &spec, None, None, &mut Silent).unwrap()
}

/// The action after two steps, the first of which saw and executed these values.
fn acted(policy: &Policy, seen: f32, executed: f32) -> Vec<Vec<Vec<f32>>> {
    let mut history = History::new(policy.segment_length());
    for (x, action) in [(seen, executed), (0.3, 0.0)] {
        history.push(policy.embed(&[&toy::frame(x, 0.5)]).unwrap().remove(0), vec![x, 0.0, 5.0]).unwrap();
        history.set_executed(vec![action, -action]).unwrap();
    }
    policy.act(&[&history]).unwrap()
}

/// Segments 2 … 8 of a failure of ten steps.
fn kept(weight: f32) -> Vec<WeightedSegments> {
    vec![WeightedSegments {
        trajectory: toy::episode("failure", 40, 10, false),
        steps: (2..9).map(|step| (step, weight)).collect(),
    }]
}

fn spec(form: &str, steps: u64) -> TrainSpec {
    TrainSpec { policy: chosen(form), ..toy::train_spec(steps) }
}

/// A policy of this form before its first step.
pub(super) fn untrained(form: &str, data: &[&Trajectory]) -> Box<dyn PolicyModel> {
    untrained_with(&spec(form, 1), data)
}

/// A policy with these settings before its first step.
fn untrained_with(spec: &TrainSpec, data: &[&Trajectory]) -> Box<dyn PolicyModel> {
    let (encoder, shape) = (encoder(1), toy::shape());
    let sample = Sample::every(data);
    let from = PolicyInit {
        shape: &shape,
        pretrained: Pretrained::encoder(&encoder),
        sample: &sample,
        spec,
        device: Device::Cpu,
    };
    let kind = find(&spec.policy.name).unwrap();
    let info = CheckpointInfo {
        format_version: FORMAT_VERSION,
        kind: CheckpointKind::Policy,
        step: 0,
        finished: false,
        shape: shape.clone(),
        model: (kind.model)(&from).unwrap(),
        policy: Some(kind.name.to_owned()),
        settings: spec.policy.settings.clone(),
        spec: String::new(),
    };
    (kind.init)(&from, &info).unwrap()
}

/// Runs `policy` on an unseen square; returns the distance of the hand from it after `steps`.
fn final_distance(policy: &Policy, square: [f32; 2], steps: u64) -> f32 {
    let mut hand = [0.5f32, 0.5];
    let (mut session, mut executed) = (policy.session(1), None::<Vec<f32>>);
    let frame = toy::frame(square[0], square[1]);
    for _ in 0..steps {
        let proprioception = [hand[0], hand[1], 5.0];
        let step = Observed { frame: &frame, proprioception: &proprioception, executed: executed.as_deref() };
        let action = policy.advance(&mut [(&mut session, &[step])]).unwrap().remove(0).remove(0);
        hand = [hand[0] + action[0], hand[1] + action[1]];
        executed = Some(action);
    }
    (hand[0] - square[0]).hypot(hand[1] - square[1])
}
